"""One run: frames in; rows, annotated video, plots and report out."""
