"""How droplets move: displacements, velocities, and what is not affine of them."""
