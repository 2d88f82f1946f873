"""Lattice Boltzmann simulations of emulsions: videos with their exact ground truth."""
