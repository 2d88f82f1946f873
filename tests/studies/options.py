"""The options that videos of a study may have."""

from droptrack.batch import options_of_videos

OPTIONS = options_of_videos()
