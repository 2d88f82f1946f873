"""Drawn images: shapes, and how scenes arrange them."""
