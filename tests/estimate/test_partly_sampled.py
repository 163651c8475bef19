"""Sessions of which samples cover a part: constants as good as they say, all else too."""

from dataclasses import dataclass, replace
from functools import cache

import numpy as np
import pytest

from smoother import so3
from smoother.estimate.initial.guess import Start, is_partly_sampled, make_start
from smoother.estimate.output import windows
from smoother.estimate.smoother import GraphOptions, GraphSmoother
from smoother.prepare import prepare
from smoother.samples import Session
from smoother.sim.simulation import Simulation, simulate_preset
from smoother.trajectory import Trajectory
from smoother.units import DEG


def with_samples(session: Session, *spans: tuple[float, float]) -> Session:
    """The session with the inertial samples of the spans, s, alone."""
    assert session.imu is not None
    use = np.any([(session.imu.t >= first) & (session.imu.t < last) for first, last in spans], axis=0)
    t, force, rate = (
        values[use] for values in (session.imu.t, session.imu.specific_force_s, session.imu.angular_rate_s)
    )
    return replace(session, imu=replace(session.imu, t=t, specific_force_s=force, angular_rate_s=rate))


@pytest.fixture(scope="module")
def whole() -> Session:
    return prepare(simulate_preset("kart", 5, duration=100.0).raw)


def started(session: Session) -> Start:
    return make_start(session, GraphOptions())


def test_a_hole_of_a_second_is_no_reason_to_leave_fixes_out(whole: Session) -> None:
    start = started(with_samples(whole, (0.0, 40.0), (41.0, 200.0)))
    assert not is_partly_sampled(start)


def test_the_stretch_that_identifies_first_is_the_busiest_with_samples() -> None:
    session = prepare(simulate_preset("kart", 5, duration=200.0).raw)
    start = make_start(with_samples(session, (150.0, 180.0)), GraphOptions(), 40.0)
    assert start.state.t[0] < 151.0
    assert start.state.t[-1] > 179.0


def test_samples_in_an_outage_of_the_fixes_tell_nothing(whole: Session) -> None:
    outage = (whole.gnss.t > 39.0) & (whole.gnss.t < 51.0)
    session = with_samples(replace(whole, gnss=whole.gnss.select(~outage)), (40.0, 50.0))
    report = GraphSmoother().estimate(session).report
    assert report.mode == "gps-only"
    assert "imu_too_short" in [problem.code for problem in report.problems]


@dataclass(frozen=True, eq=False)
class Smoothed:
    """A simulated session, the spans of its samples, s, what was made of it, and the truth at its rows."""

    simulation: Simulation
    spans: tuple[tuple[float, float], ...]
    trajectory: Trajectory
    truth: Trajectory

    @property
    def z(self) -> np.ndarray:
        """Errors (4,) of both latencies and of the arm ahead and to the left, over their sigmas."""
        found, true = self.trajectory.report.identified, self.simulation.scenario
        arm = found["lever_arm_b"]
        error = [*np.subtract(arm.value, true.lever_arm_b)[:2]]
        sigma = [*np.asarray(arm.sigma)[:2]]
        for name in ("position", "velocity"):
            latency = found[f"gps_{name}_latency"]
            error.append(float(np.asarray(latency.value)) - getattr(true.gnss, f"{name}_latency"))
            sigma.append(float(np.asarray(latency.sigma)))
        return np.divide(error, sigma)

    @property
    def velocity_error_n(self) -> np.ndarray:
        """Horizontal velocity error (N, 2) m/s."""
        return (self.trajectory.velocity_n - self.truth.velocity_n)[:, :2]

    @property
    def turn(self) -> np.ndarray:
        """Attitude error (N, 3) rad."""
        return so3.log(self.trajectory.R_nb.transpose(0, 2, 1) @ self.truth.R_nb)

    def rows(self, *, sampled: bool) -> np.ndarray:
        """Mask (N,) of the rows with samples, or of those without, a second from where that changes."""
        t, edge = self.trajectory.t, 1.0 if sampled else -1.0
        inside = np.any([(t > first + edge) & (t < last - edge) for first, last in self.spans], axis=0)
        return (inside if sampled else ~inside) & (t > 20.0)  # from the standing start on


@cache
def smoothed(*spans: tuple[float, float], seed: int = 3, duration: float = 300.0, solver: str = "batch") -> Smoothed:
    simulation = simulate_preset("kart", seed, duration=duration, gnss_outages=())
    session = with_samples(prepare(simulation.raw), *spans)
    trajectory = GraphSmoother(GraphOptions(solver=solver)).estimate(session)
    arm = simulation.scenario.lever_arm_b
    return Smoothed(simulation, spans, trajectory, simulation.truth.trajectory(trajectory.t, arm, session.origin))


def rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(values**2)))


LATE, EARLY, SHORT, PAUSED = ((200.0, 1e3),), ((-1.0, 100.0),), ((150.0, 180.0),), ((-1.0, 60.0), (180.0, 1e3))
PARTS = (LATE, EARLY, SHORT, PAUSED)


@pytest.mark.parametrize("spans", PARTS)
def test_constants_are_as_far_off_as_they_say(spans: tuple[tuple[float, float], ...]) -> None:
    assert rms(smoothed(*spans).z) < 1.6
    assert np.max(np.abs(smoothed(*spans).z)) < 3.0


@pytest.mark.parametrize("spans", PARTS)
def test_where_there_are_samples_the_result_is_as_good_as_with_samples_everywhere(
    spans: tuple[tuple[float, float], ...],
) -> None:
    part, everywhere = smoothed(*spans), smoothed((-1.0, 1e3))
    rows = part.rows(sampled=True)
    assert rms(part.velocity_error_n[rows]) < 1.2 * rms(everywhere.velocity_error_n[rows])
    assert rms(part.turn[rows]) < 1.3 * rms(everywhere.turn[rows])
    assert part.trajectory.sigmas is not None
    assert 0.6 < rms(part.turn[rows]) / rms(part.trajectory.sigmas.attitude[rows]) < 1.4


@pytest.mark.parametrize("spans", PARTS)
def test_the_error_of_the_mounting_fits_its_sigma(spans: tuple[tuple[float, float], ...]) -> None:
    part = smoothed(*spans)
    found = part.trajectory.report.identified["R_bs"]
    turn = so3.log(np.asarray(found.value) @ part.simulation.scenario.R_bs.T)
    assert found.observable
    assert rms(turn / np.asarray(found.sigma)) < 1.6


@pytest.mark.parametrize("spans", PARTS)
def test_elsewhere_it_is_as_good_as_fixes_alone_with_their_sigmas(spans: tuple[tuple[float, float], ...]) -> None:
    part = smoothed(*spans)
    rows = part.rows(sampled=False)
    velocity_n, turn, sigmas = part.velocity_error_n[rows], part.turn[rows], part.trajectory.sigmas
    assert sigmas is not None
    assert rms(velocity_n) < 0.15  # m/s per axis; of the fixes alone 0.12
    assert rms(turn) < 4.0 * DEG  # the kart leans by less than a degree and slides by some
    # rows between keyframes are said to be more uncertain than they are
    assert 0.4 < rms(velocity_n / sigmas.velocity_n[rows, :2]) < 1.2
    assert 0.3 < rms(part.trajectory.euler[rows, :2] / sigmas.attitude[rows, :2]) < 1.3


def test_a_session_of_windows_has_the_constants_of_the_samples(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(windows, "WINDOW", 80.0)
    monkeypatch.setattr(windows, "OVERLAP", 40.0)
    long = smoothed((200.0, 230.0), duration=301.0)
    assert rms(long.z) < 1.6
    assert rms(long.velocity_error_n[long.rows(sampled=False)]) < 0.15


def test_a_stream_has_them_too() -> None:
    stream = smoothed((50.0, 90.0), duration=150.0, solver="isam2")
    assert rms(stream.z) < 1.6
    assert rms(stream.velocity_error_n[stream.rows(sampled=True)]) < 0.12
