"""Figures and files of a smoothed session. Draws and writes; computes nothing."""
