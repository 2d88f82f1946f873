"""Many videos: what there is to do, the workers that do it, and one table, data set and page."""
