"""Do droplets move like a flock? Headings beside those of neighbours, and beside chance."""
