"""What is found of a recording does not hang on what nobody can measure."""

from dataclasses import replace
from pathlib import Path

import numpy as np

from smoother.estimate.graph.smoother import GraphSmoother
from smoother.prepare import prepare
from smoother.samples import Session
from smoother.session.load import load_raw


def beginning(session: Session, duration: float) -> Session:
    """The first `duration` s of a session."""
    assert session.imu is not None
    gnss, end = session.gnss, session.gnss.t[0] + duration
    return replace(session, gnss=gnss.select(gnss.t < end), imu=session.imu.between(session.imu.t[0], end))


def with_noise(session: Session, metres: float) -> Session:
    """The session with its places off by some `metres`; those that a receiver repeats stay the same."""
    gnss = session.gnss
    degrees = metres / 1.1e5 * np.random.default_rng(0).standard_normal((2, len(gnss)))
    moves = np.append(True, (np.diff(gnss.lat_deg) != 0.0) | (np.diff(gnss.lon_deg) != 0.0))
    off = np.where(moves, degrees, 0.0)
    return replace(session, gnss=replace(gnss, lat_deg=gnss.lat_deg + off[0], lon_deg=gnss.lon_deg + off[1]))


def test_a_millimetre_changes_little_on_a_steering_wheel(data_directory: Path) -> None:
    """Lignano: the engine is folded by 25 samples a second, the box turns. Solutions wandered, and ended anywhere."""
    session = beginning(prepare(load_raw(data_directory / "kart_lignano_racebox")), 600.0)
    one, other = (GraphSmoother().estimate(s) for s in (session, with_noise(session, 1e-3)))
    apart = (one.velocity_n - other.velocity_n)[:, :2] / one.sigmas.velocity_n[:, :2]
    assert np.sqrt(np.mean(apart**2)) < 0.3
    found = [np.asarray(t.report.identified["gps_velocity_response"].value) for t in (one, other)]
    sigma = one.report.identified["gps_velocity_response"].sigma
    assert sigma is not None
    assert abs(found[0] - found[1]) < float(np.asarray(sigma))


def test_parts_of_a_drive_with_a_folded_engine_tell_the_same_delay(data_directory: Path) -> None:
    """Lignano: its first 400 s had the antenna 0.7 m ahead and 0.05 s later than all other parts."""
    session = prepare(load_raw(data_directory / "kart_lignano_racebox"))
    begin = session.gnss.t[0]
    delays = []
    for first, last in ((0.0, 400.0), (300.0, 900.0)):
        use = (session.gnss.t >= begin + first) & (session.gnss.t < begin + last)
        assert session.imu is not None
        imu = session.imu.between(max(begin + first, session.imu.t[0]), begin + last)
        part = replace(session, gnss=session.gnss.select(use), imu=imu)
        delays.append(GraphSmoother().estimate(part).report.identified["gps_position_latency"])
    apart = abs(float(np.asarray(delays[0].value)) - float(np.asarray(delays[1].value)))
    assert apart < 0.02
