"""Synthetic images and videos of droplets with their exact ground truth."""
