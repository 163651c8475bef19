"""What is estimated and what it is estimated from: unknowns, keyframes, inertial samples, motion, noise."""
