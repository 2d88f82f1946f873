"""Boxes -> tracks -> final rows."""
