"""Readers of other programs' recordings: each makes columns with names and units, columns.py makes a recording."""
