"""Drawn videos and motions with their exact ground truth."""
