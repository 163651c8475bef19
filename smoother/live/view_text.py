"""Texts of the views: common to the window and the terminal."""

import math

import numpy as np

from smoother.frames import euler_from_rotation
from smoother.laps.clock import lap_clock
from smoother.live.engine import SILENT, Snapshot
from smoother.live.frame import Frame
from smoother.live.receiver import LinkStatus
from smoother.units import DEG, KMH

HINTS = {
    "no such port": "is it plugged in, and is the name right? `ls /dev/tty*` shows what is there",
    "permission denied": "who may use it? `ls -l` shows its group, mostly dialout; `id` shows yours",
}


def angles(R: np.ndarray | None) -> tuple[str, str, str]:
    """Roll, pitch and yaw in degrees, dashes without an attitude."""
    if R is None:
        return "-", "-", "-"
    roll, pitch, yaw = (float(angle) / DEG for angle in euler_from_rotation(R))
    return f"{roll:+.1f}°", f"{pitch:+.1f}°", f"{yaw:+.0f}°"


def gps(s: Snapshot) -> str:
    """Fix, satellites, hdop."""
    satellites = "" if s.reception.satellites < 0 else f", {s.reception.satellites} satellites"
    hdop = f", hdop {s.reception.hdop:.1f}" if math.isfinite(s.reception.hdop) else ""
    if s.fix_age > SILENT or s.reception.fix == 0:
        waited = f" for {s.fix_age:.0f} s" if math.isfinite(s.fix_age) and s.fix_age > SILENT else ""
        return f"NO FIX{waited}{satellites}"
    return f"fix{satellites}{hdop}"


def is_gps_good(s: Snapshot) -> bool:
    """Whether there is a fix from enough satellites."""
    return s.fix_age <= SILENT and s.reception.fix > 0 and not 0 <= s.reception.satellites < 5


def speed(s: Snapshot) -> str:
    """Speed in km/h."""
    return f"{s.speed / KMH:.1f} km/h" if math.isfinite(s.speed) else "- km/h"


def laps(s: Snapshot) -> str:
    """Running lap, last and best."""
    if not s.laps.has_line:
        return "line not found yet"
    running, last, best = (lap_clock(time, 2) for time in (s.laps.running, s.laps.last, s.laps.best))
    return f"lap {s.laps.lap}  {running}   last {last}   best {best}"


def is_stale(frame: Frame) -> bool:
    """Whether the data is old because nothing is received."""
    return (frame.delay > SILENT and not frame.is_held) or (not frame.link.is_open and not frame.link.is_over)


def rates(frame: Frame) -> str:
    """Samples a second of each sensor."""
    s = frame.snapshot
    if is_stale(frame):
        return "-"
    return "   ".join(
        f"{label} {s.rates.get(name, 0.0):.{digits}f} Hz"
        for name, label, digits in (("imu", "IMU", 0), ("mag", "compass", 0), ("gps", "GPS", 1))
    )


def losses(frame: Frame) -> str:
    """All losses that occurred."""
    s, link = frame.snapshot, frame.link
    counts = [
        (s.losses.lost_frames, f"{s.losses.lost_frames} frames lost ({s.losses.lost_share:.1%})"),
        (s.losses.damaged, f"{s.losses.damaged} damaged"),
        (s.losses.noise_bytes, f"{s.losses.noise_bytes} bytes of noise or text"),
        (link.dropped_bytes, f"{link.dropped_bytes} bytes dropped"),
        (link.disconnects, f"{link.disconnects} x unplugged"),
        (s.losses.restarts, f"logger restarted {s.losses.restarts} x"),
        (s.left_out, f"{s.left_out:.0f} s not smoothed"),
    ]
    return ", ".join(text for count, text in counts if count) or "nothing lost"


def connection(link: LinkStatus, name: str) -> str:
    """Whether the port is open."""
    if link.is_over:
        return f"{name}: end"
    if link.is_open:
        return f"{name}: connected"
    return f"{name}: NOT CONNECTED{f' ({trouble(link)})' if link.error else ''}, trying again"


def trouble(link: LinkStatus) -> str:
    """Why a port is not open, with a hint, unless it was open before."""
    hint = "" if link.disconnects else HINTS.get(link.error, "")
    return f"{link.error}; {hint}" if hint else link.error


def delay(frame: Frame) -> str:
    """Age of the displayed data, and of the smoother's state."""
    if frame.is_held:
        return "the file waits for the smoother"
    if frame.delay > SILENT and not frame.link.is_over:
        return f"no data for {frame.delay:.0f} s"
    own = f", smoother {1e3 * frame.smoother_delay:.0f} ms" if math.isfinite(frame.smoother_delay) else ""
    return f"{1e3 * frame.delay:.0f} ms{own}"


def is_recording_well(frame: Frame) -> bool:
    """Whether the recording has no failure."""
    return frame.recording is None or not frame.recording.flaw


def recording(frame: Frame) -> str:
    """State of the recording."""
    if frame.recording is None:
        return "off"
    if frame.recording.flaw:
        return f"FAILS: {frame.recording.flaw}"
    return f"{frame.recording.name}, {frame.recording.bytes_written / 1e6:.2f} MB" if frame.recording.name else "waits"


def smoother(s: Snapshot) -> str:
    """Stage of the smoother, and its sigmas."""
    if s.is_calibrating:
        return "calibrating the compass: turn the logger in all directions"
    if s.lag is None:
        return s.stage
    worst = float(np.max(s.lag.attitude_sigma)) / DEG
    if worst > 30.0:  # deg, of an attitude before the mounting is identified
        return "smoothing, the mounting is not accurate yet"
    return f"smoothing, attitude ±{worst:.1f}°, speed ±{float(np.max(s.lag.velocity_sigma[:2])) / KMH:.1f} km/h"
