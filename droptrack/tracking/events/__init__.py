"""Trajectories -> what happened: coalescence, break-up, entering, leaving, passages, residence."""
