"""What a session is before its graph is solved: one clock, aligned, and a first guess of all unknowns."""
