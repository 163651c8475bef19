"""The factors of the graph, one file each; table.py lists them and graph.py builds the graph of a session from it."""
