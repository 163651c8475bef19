"""A kart that stands under a roof with its engine off: fixes wander at walking pace, and the samples know better."""

from dataclasses import replace

import numpy as np
import pytest

from smoother.arrays import Array
from smoother.estimate.judge.quality import assess
from smoother.estimate.smoother import GraphSmoother
from smoother.frames import nwu_to_geodetic
from smoother.prepare import prepare
from smoother.samples import Session
from smoother.sim.simulation import simulate_preset

STANDS = 45.0  # s
WANDER, PACE, LASTS = 15.0, 0.4, 8.0  # m, m/s and s


def gauss_markov(rng: np.random.Generator, t: Array, sigma: float) -> Array:
    out = np.zeros((len(t), 3))
    for k, h in enumerate(np.diff(t)):
        keep = np.exp(-h / LASTS)
        out[k + 1] = keep * out[k] + sigma * np.sqrt(1.0 - keep**2) * rng.normal(size=3)
    return out


@pytest.fixture(scope="module")
def garage() -> Session:
    session, rng = (
        prepare(simulate_preset("kart", 4, duration=200.0, motion_standstill=STANDS).raw),
        np.random.default_rng(4),
    )
    assert session.imu is not None
    imu, gnss = session.imu, session.gnss
    off = imu.t < STANDS - 3.0
    force, rate = imu.specific_force_s.copy(), imu.angular_rate_s.copy()
    force[off] = force[off].mean(axis=0) + 0.03 * rng.normal(size=(off.sum(), 3))
    rate[off] = rate[off].mean(axis=0) + 0.001 * rng.normal(size=(off.sum(), 3))
    under = np.clip((STANDS - 5.0 - gnss.t) / 3.0, 0.0, 1.0)[:, None]
    places = session.fix_position_n + under * gauss_markov(rng, gnss.t, WANDER)
    lat, lon, alt = nwu_to_geodetic(places, session.origin)
    velocity = gnss.velocity_n + under * gauss_markov(rng, gnss.t, PACE)
    fixes = replace(gnss, lat_deg=lat, lon_deg=lon, alt_m=alt, velocity_n=velocity)
    return replace(session, gnss=fixes, imu=replace(imu, specific_force_s=force, angular_rate_s=rate))


def test_it_stands_and_the_result_is_good(garage: Session) -> None:
    found = GraphSmoother().estimate(garage)
    assert found.sigmas is not None
    at_rest = (found.t > 3.0) & (found.t < STANDS - 6.0)
    assert np.sqrt(np.mean(found.velocity_n[at_rest, :2] ** 2)) < 0.03
    assert np.mean(np.abs(found.velocity_n[at_rest, :2]) < 2.0 * found.sigmas.velocity_n[at_rest, :2]) > 0.9
    noise = found.report.identified["gps_velocity_noise"].value
    assert isinstance(noise, list) and noise[0] < 0.15  # of the drive, 0.1
    assert assess(garage, found).passed
