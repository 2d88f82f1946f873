"""Weights for one's own set-up: what a video shows -> images like it -> a network trained on."""
