"""Estimations that calib/ and estimate/ share: standstill, gyro bias, ellipsoid, levelling."""
