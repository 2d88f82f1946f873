"""Readers of everything that holds a video: each gives a `Source`, images with their numbers."""
