"""Estimators: session in, trajectory out."""
