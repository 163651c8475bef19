"""Calibration procedures a person performs, one module each, on the fits of smoother.fit."""
