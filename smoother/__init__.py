"""Smooth a go-kart session offline: position, velocity, attitude and lap times, each with an error bar.

The value flows one way::

    RawSession --calibrate--> Session --estimate--> Trajectory --> laps --> report, export

Conventions of frames, units and names: :mod:`smoother.frames`.
"""

__version__ = "0.1.0"
