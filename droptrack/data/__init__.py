"""Typed values and their files: images and videos, detections, data sets, trajectories, reports."""
