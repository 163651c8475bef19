"""A snapshot as one line of JSON, for scripts: degrees and SI, null for unknown values."""

import json
import math
from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from smoother.frames import euler_from_rotation
from smoother.live.frame import Frame
from smoother.units import DEG


def document_of(frame: Frame) -> dict[str, object]:
    """Return a frame as plain values; keys end in their units."""
    s, link, recording = frame.snapshot, frame.link, frame.recording
    lag = s.lag
    return {
        "t_s": s.t,
        "stage": s.stage,
        "delay_s": frame.delay,
        "madgwick": None if s.madgwick is None else _angles(s.madgwick),
        "smoother": None
        if lag is None
        else {
            **_angles(lag.R_nb),
            "sigma_attitude_deg": (lag.attitude_sigma / DEG).tolist(),
            "position_n_m": lag.position_n.tolist(),
            "velocity_n_mps": lag.velocity_n.tolist(),
            "sigma_velocity_mps": lag.velocity_sigma.tolist(),
            "behind_fix_s": lag.delay,
            "delay_s": frame.smoother_delay,
        },
        "specific_force_s_mps2": s.force.tolist(),
        "angular_rate_s_dps": (s.rate / DEG).tolist(),
        "rates_hz": s.rates,
        "gps": {
            "fix": s.reception.fix,
            "satellites": None if s.reception.satellites < 0 else s.reception.satellites,
            "hdop": s.reception.hdop,
            "age_s": s.fix_age,
            "speed_mps": s.speed,
            "lat_deg": s.lat_deg,
            "lon_deg": s.lon_deg,
        },
        "laps": {"lap": s.laps.lap, "running_s": s.laps.running, "last_s": s.laps.last, "best_s": s.laps.best},
        "compass": {"is_calibrating": s.is_calibrating},
        "losses": {
            "lost_frames": s.losses.lost_frames,
            "lost_share": s.losses.lost_share,
            "damaged_frames": s.losses.damaged,
            "noise_bytes": s.losses.noise_bytes,
            "restarts": s.losses.restarts,
            "disconnects": link.disconnects,
            "dropped_bytes": link.dropped_bytes,
            "left_out_s": s.left_out,
        },
        "recording": None
        if recording is None
        else {"file": recording.name, "bytes": recording.bytes_written, "flaw": recording.flaw or None},
        "connected": link.is_open,
    }


def line_of(frame: Frame) -> str:
    """Return :func:`document_of` as one line."""
    return json.dumps(_plain(document_of(frame)), allow_nan=False)


def news_of(frame: Frame) -> str:
    """Return its line without elapsed times: equal as long as nothing is new."""
    return line_of(replace(frame, delay=0.0, smoother_delay=0.0))


def _angles(R: np.ndarray) -> dict[str, object]:
    roll, pitch, yaw = euler_from_rotation(R)
    return {"roll_deg": float(roll / DEG), "pitch_deg": float(pitch / DEG), "yaw_deg": float(yaw / DEG)}


def _plain(value: object) -> object:
    """Numbers with six digits, null for NaN, which JSON does not have."""
    if isinstance(value, Mapping):
        return {str(key): _plain(item) for key, item in value.items()}
    if isinstance(value, list):
        return [_plain(item) for item in value]
    if isinstance(value, float):
        return round(value, 6) if math.isfinite(value) else None
    return value
