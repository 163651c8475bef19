"""Ways to solve the graph, and what a solution says of its own uncertainty."""
