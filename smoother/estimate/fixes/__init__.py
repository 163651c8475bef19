"""The path through the fixes alone: where every session begins, and the result of one without inertial samples."""
