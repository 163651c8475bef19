"""Calibration procedures a person performs, one module each, on the fits of smoother.fit.

A procedure is a function `calibrate(..)`, or `calibrate_..(..)` where a module has a second one. It returns an
:class:`calib.outcome.Outcome` or raises FitError with the one sentence that says why not and what to do.
:mod:`calib.run` runs what a recording offers.
"""
