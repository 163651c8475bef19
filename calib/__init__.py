"""Calibration procedures a person performs, one module each, on the fits of smoother.fit.

A procedure is a function `calibrate(..)`, or `calibrate_..(..)` where a module has a second one. It returns an
:class:`calib.outcome.Outcome` or raises FitError with one sentence: reason and remedy. :mod:`calib.run` runs every
procedure that a recording is sufficient for.
"""
