"""Calibration procedures a person performs, one module each, on the fits of smoother.fit.

Each module has one function `calibrate(..)`, which returns an :class:`calib.outcome.Outcome` or raises FitError with
the one sentence that says why not and what to do. :mod:`calib.run` runs what a recording offers.
"""
