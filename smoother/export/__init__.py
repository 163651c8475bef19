"""A smoothed session in the files that other programs open: one module per format, one pass over the rows each."""
