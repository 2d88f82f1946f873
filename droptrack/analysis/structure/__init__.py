"""How droplets are arranged in a frame, and when neighbours change."""
