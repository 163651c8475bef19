"""The reference baseline: Madgwick attitude and a 6-state Kalman filter."""
