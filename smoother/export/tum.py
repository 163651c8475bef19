"""TUM, the trajectory format of the visual odometry benchmarks: `t x y z qx qy qz qw`, read by evo and its like.

t is the session clock (as in trajectory.csv and truth.csv), x y z are north, west, up in n, the quaternion is of R_nb.
Without an inertial sensor the attitude is level along the course: the format has no blanks.
"""

from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from smoother.arrays import Array
from smoother.export.rows import Rows
from smoother.export.source import Source
from smoother.export.text import lines
from smoother.report.files import replacing

ROW = "%.6f %.4f %.4f %.4f %.9f %.9f %.9f %.9f\n"


def write(source: Source, path: Path) -> None:
    """Write the session as TUM."""
    with replacing(path) as temporary, temporary.open("w", encoding="utf-8", newline="") as file:
        file.write(
            "# t x y z qx qy qz qw; s, m; x north, y west, z up of the origin; attitude of forward-left-up axes\n"
        )
        for rows in source.rows():
            position = [rows[name] for name in ("t_s", "north_m", "west_m", "up_m")]
            file.write(lines(ROW, [*position, *quaternion(rows).T]))


def quaternion(rows: Rows) -> Array:
    """Quaternion (N, 4) of R_nb, scalar last, positive."""
    yaw = np.where(np.isfinite(rows["yaw_deg"]), rows["yaw_deg"], -rows["course_deg"])
    roll, pitch = (np.nan_to_num(rows[name], nan=0.0) for name in ("roll_deg", "pitch_deg"))
    rotation = Rotation.from_euler("ZYX", np.stack([yaw, pitch, roll], axis=-1), degrees=True)
    return np.asarray(rotation.as_quat(canonical=True))
