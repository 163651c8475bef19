"""Laps and driver analysis: lines, crossing times with sigma, a reference line, delta by position, corners."""
