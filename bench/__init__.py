"""Measurements of speed and accuracy, ``make bench``."""
