"""How good detections and trajectories are against the ground truth."""
