"""What is checked when a recording is read: one table of checks, one loop, findings as values."""
