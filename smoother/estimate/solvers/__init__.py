"""Solvers of the graph, the covariance of a solution, and the noise that its residuals show."""
