"""From a solved graph to what people use: rows of the trajectory with their sigmas, and everything identified."""
