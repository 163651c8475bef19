"""Named factors and constants. Multiply to go to SI, divide to go back: `yaw = yaw_deg * DEG`. Imports nothing."""

DEG = 0.017453292519943295  # rad
ANY_ANGLE = 1.8137993642342178  # rad, one sigma of an angle that may be any: pi over the root of three
STANDARD_GRAVITY = 9.80665  # m/s^2, also the value of 1 g in sensor full scales
KMH = 1.0 / 3.6  # m/s
MPH = 0.44704  # m/s
KNOT = 1852.0 / 3600.0  # m/s
FOOT = 0.3048  # m
MICROSECOND = 1e-6  # s
MILLISECOND = 1e-3  # s
DAY = 86400.0  # s
