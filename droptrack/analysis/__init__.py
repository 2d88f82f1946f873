"""Trajectories -> the quantities that papers report, each with its error and a null model."""
