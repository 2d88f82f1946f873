"""The tracker made for droplets: a module a stage of its `DropletTracker.update`."""
