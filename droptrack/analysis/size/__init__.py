"""How large droplets are, how different, and how deformed where."""
