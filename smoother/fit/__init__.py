"""Estimations that calib/, estimate/ and laps/ share: of sensors at rest and turned, standstill, spectra, filters."""
