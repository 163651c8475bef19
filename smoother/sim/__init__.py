"""Simulated karts: analytic truth, sensors that err as told, and the files a logger would have written."""
