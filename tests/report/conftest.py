"""A short simulated session, and a trajectory for it as an estimator would return it."""

import numpy as np
import pytest

from smoother.laps.analysis import LapOptions, analyse, reference_lap_of
from smoother.laps.results import FixPath, Lap
from smoother.laps.stage import analysed_rows
from smoother.laps.stored import Stored
from smoother.prepare import prepare
from smoother.report.compare_page import Compared
from smoother.samples import Problem, Session
from smoother.sim.simulation import Simulation, simulate_preset
from smoother.trajectory import (
    EstimateReport,
    FixResiduals,
    Identified,
    Keyframes,
    ResidualStatistics,
    Sigmas,
    Trajectory,
)


@pytest.fixture(scope="session")
def simulation() -> Simulation:
    return simulate_preset("kart", 5, duration=40.0)


@pytest.fixture(scope="session")
def session(simulation: Simulation) -> Session:
    return prepare(simulation.raw)


@pytest.fixture(scope="session")
def trajectory(simulation: Simulation, session: Session) -> Trajectory:
    """The truth at 50 Hz, with sigmas and a report."""
    t = np.arange(session.gnss.t[0], session.gnss.t[-1], 0.02)
    truth = simulation.truth.trajectory(t, simulation.scenario.lever_arm_b)
    n, k = len(t), len(session.gnss)
    sigmas = Sigmas(
        np.full((n, 3), 1.5), np.full((n, 3), 0.1), np.full(n, 0.1), np.full((n, 3), 0.01), np.full(n, 0.05)
    )
    zero = np.zeros((k, 3))
    keyframes = Keyframes(
        session.gnss.t, zero, zero, np.tile(np.eye(3), (k, 1, 1)), np.tile(np.eye(9), (k, 1, 1)), zero, zero, zero, zero
    )
    residual = np.random.default_rng(1).normal(0.0, 0.3, (k, 3))
    weight = np.where(np.arange(k) % 20 == 0, 0.0, 1.0)
    report = EstimateReport(
        identified={
            "gps_position_latency": Identified(0.12, 0.01, "s", True, "identified"),
            "R_bs": Identified(np.eye(3).tolist(), [0.01, 0.01, 0.02], "rad", True, "identified"),
            "lever_arm_b": Identified([0.3, 0.0, 0.5], None, "m", False, "default"),
        },
        residuals={"gps_position": ResidualStatistics("m", k, 0.0, 0.3, float("nan"), 2)},
        fixes=FixResiduals(np.arange(k), residual, weight),
        keyframes=keyframes,
        problems=(Problem("short", "a short session", 2),),
        timings={"solve": 0.5},
    )
    return Trajectory(**{**vars(truth), "sigmas": sigmas, "report": report})


@pytest.fixture(scope="session")
def compared() -> list[Compared]:
    """Two drives on one track, from truth: the second's GPS is two metres off, and its name is not a kind one."""
    stored = [_driven(seed, aside) for seed, aside in ((5, 0.0), (6, 2.0))]
    names = ["first", "<script>alert(1)</script>"]
    own = analyse(stored[0].trajectory, stored[0].fixes)
    lap = reference_lap_of(own, stored[0].trajectory, stored[0].fixes, f"first lap {_best(own.laps)}")
    options = LapOptions(reference=own.reference, reference_lap=lap)
    references = [own.reference_lap, None]
    return [
        Compared(name, s, analyse(s.trajectory, s.fixes, options), reference)
        for name, s, reference in zip(names, stored, references, strict=True)
    ]


def _best(laps: tuple[Lap, ...]) -> int:
    return min((lap for lap in laps if lap.is_valid), key=lambda lap: lap.time).number


def _driven(seed: int, aside: float) -> Stored:
    drive = simulate_preset("kart", seed, track="tinbarn", duration=170.0)
    t = np.arange(0.5, 169.0, 0.02)
    truth, n = drive.truth.trajectory(t, drive.scenario.lever_arm_b), len(t)
    sigmas = Sigmas(
        np.full((n, 3), 1.5), np.full((n, 3), 0.1), np.full(n, 0.1), np.full((n, 3), 0.01), np.full(n, 0.05)
    )
    moved = Trajectory(
        **{**vars(truth), "sigmas": sigmas, "position_n": truth.position_n + np.array([aside, 0.0, 0.0])}
    )
    rows = analysed_rows(moved)
    return Stored(rows, FixPath(t[::10], moved.position_n[::10, :2]), drive.truth.origin, None, None, {})
