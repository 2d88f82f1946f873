"""Synthetic pictures and videos of droplets whose truth is known exactly."""
