"""The factors of the graph, one file each; graph.py has their table and builds the graph of a session from it."""
