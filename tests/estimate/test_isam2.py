"""The two solvers from a session to its trajectory: whoever streams gets what the batch gives."""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest

from smoother import so3
from smoother.estimate.smoother import GraphOptions, GraphSmoother
from smoother.estimate.solvers import identify
from smoother.prepare import prepare
from smoother.samples import Session
from smoother.session.clock import regularize, true_fix_times
from smoother.sim.simulation import simulate_preset
from smoother.trajectory import Trajectory

SEED, DURATION = 4, 100.0


def session() -> Session:
    """A kart with latencies, a lever arm, any mounting, vibration, a slow GPS offset, an outage and a bad compass."""
    raw = simulate_preset("kart", SEED, track="tinbarn", duration=DURATION).raw
    assert raw.imu is not None
    assert raw.gnss.unix_s is not None
    imu = replace(raw.imu, t=regularize(raw.imu.t).t)
    return prepare(replace(raw, imu=imu, gnss=replace(raw.gnss, t=true_fix_times(raw.gnss.t, raw.gnss.unix_s)[0])))


@pytest.fixture(scope="module", params=[False, True])
def solutions(request: pytest.FixtureRequest) -> Iterator[tuple[Trajectory, Trajectory]]:
    """Of both solvers, without wheels and with them; both go on until they stay where they are."""
    given = session()
    with pytest.MonkeyPatch.context() as patch:
        for name, limit in (("MOVED", 0.01), ("STILL_ANGLE", 1e-5)):
            patch.setattr(identify, name, limit)
        yield tuple(
            GraphSmoother(GraphOptions(solver=solver, wheels=request.param)).estimate(given)
            for solver in ("batch", "isam2")
        )  # type: ignore[return-value]


def test_the_stream_gives_the_trajectory_of_the_batch(solutions: tuple[Trajectory, Trajectory]) -> None:
    batch, stream = solutions
    assert (batch.report.mode, stream.report.mode) == ("full", "full")
    np.testing.assert_array_equal(stream.t, batch.t)
    assert np.any(stream.position_n != batch.position_n)  # it is not the batch under another name
    assert batch.sigmas is not None
    # fractions of a sigma: nothing that anyone can see
    for name in ("position_n", "velocity_n"):
        apart = np.abs(getattr(stream, name) - getattr(batch, name)) / getattr(batch.sigmas, name)
        assert float(np.sqrt(np.mean(apart**2))) < 0.2, name
        assert float(np.max(apart)) < 0.5, name
    turn = so3.log(np.swapaxes(batch.R_nb, 1, 2) @ stream.R_nb)
    assert float(np.max(np.linalg.norm(turn, axis=1) / np.min(batch.sigmas.attitude, axis=1))) < 0.5


def test_the_stream_has_the_sigmas_of_the_batch(solutions: tuple[Trajectory, Trajectory]) -> None:
    batch, stream = solutions
    assert batch.sigmas is not None
    assert stream.sigmas is not None
    for name in ("position_n", "velocity_n", "attitude", "track"):
        np.testing.assert_allclose(getattr(stream.sigmas, name), getattr(batch.sigmas, name), rtol=0.08, err_msg=name)


def test_the_constants_of_the_stream_are_those_identified(solutions: tuple[Trajectory, Trajectory]) -> None:
    batch, stream = solutions
    for key in ("gps_position_latency", "gps_velocity_latency", "lever_arm_b"):
        found, expected = stream.report.identified[key], batch.report.identified[key]
        assert (found.observable, found.source) == (expected.observable, expected.source)
        difference = np.abs(np.asarray(found.value) - np.asarray(expected.value))
        assert np.all(difference < 0.5 * np.asarray(expected.sigma)), key
