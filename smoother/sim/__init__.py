"""Simulated karts: analytic truth, sensors with stated errors, and the files a logger would have written."""
