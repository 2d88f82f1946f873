"""Training by the Darknet binary."""
