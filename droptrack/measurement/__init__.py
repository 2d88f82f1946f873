"""Box -> what is measured of the droplet in it, from the grey levels."""
