"""The GTSAM factor-graph smoother."""
