"""The thesis' two files: out.txt (IMU, magnetometer, NMEA) and magcalib.txt. Owns their byte layout.

A record of out.txt is, little endian,

    RECORD_START  IMU_STRUCT  [flag]  END_STRUCT                              without GPS data, flag optional
    RECORD_START  IMU_STRUCT  GPS_FLAG  MAG_STRUCT  <NMEA block>  END_STRUCT  with GPS data

where the NMEA block is the receiver's whole buffer, so it has one length throughout a file: the sentence, then
whatever the buffer held before. magcalib.txt is RECORD_START (or its first byte) and MAG_STRUCT triples.
"""

import struct

from smoother.units import DEG, STANDARD_GRAVITY

RECORD_START = b"YY"
IMU_STRUCT = struct.Struct("<I6h")  # start time in ms (wraps at 2^32), ax ay az gx gy gz in counts
GPS_FLAG = 0x71  # this byte after the IMU values: magnetometer and NMEA follow
NO_GPS_FLAG = 0x00  # the optional flag byte of a record without GPS data
MAG_STRUCT = struct.Struct("<3h")  # my, mx, -mz in counts
END_STRUCT = struct.Struct("<I")  # end time in ms

ACCEL_FULL_SCALE = 4.0 * STANDARD_GRAVITY  # m/s^2
GYRO_FULL_SCALE = 500.0 * DEG  # rad/s
ACCEL_SCALE = ACCEL_FULL_SCALE / 32768.0  # m/s^2 per count
GYRO_SCALE = GYRO_FULL_SCALE / 32768.0  # rad/s per count
