"""What a live stream cannot find by itself while it runs: mounting, delays, noise. Done on what has come so far.

The batch smoother runs over the window in a process of its own; the stream then starts again from the head of the
window with those values, its priors as wide as ever, so that no fix counts twice.
"""

from dataclasses import dataclass, replace
from typing import Generic, Protocol, TypeVar

import numpy as np

from smoother.arrays import Array
from smoother.errors import SmootherError
from smoother.estimate.model.inertial_noise import InertialNoise
from smoother.estimate.smoother import GraphOptions, GraphSmoother
from smoother.frames import Origin
from smoother.laps.circuit import find_circuit
from smoother.laps.path import PlanPath
from smoother.laps.results import GivenLines, Line
from smoother.live.lag import LagStart
from smoother.samples import GnssFixes, ImuSamples, Problem, Session

T_co = TypeVar("T_co", covariant=True)
OUTPUT_RATE = 5.0  # Hz; only the start of the window is read
SHORTEST_LAP = 100.0  # m, as for recorded laps
MOVED = 5.0  # m/s; slower fixes say little about the mounting


@dataclass(frozen=True, eq=False)
class Window:
    """What has come, oldest first. Fixes as in a session; n placed at `origin`."""

    imu: ImuSamples
    fixes: GnssFixes
    origin: Origin


def identify(window: Window) -> LagStart | str:
    """Return where and with which values a stream over the window begins, or why it cannot.

    Those of samples as they come: the stream does not wait for a force that is late.
    """
    session = Session("live", window.fixes, window.origin, window.imu)
    try:
        trajectory = GraphSmoother(replace(GraphOptions(), rate=OUTPUT_RATE, in_step=False)).estimate(session)
    except (SmootherError, ValueError, np.linalg.LinAlgError) as error:
        return str(error)
    report, keyframes = trajectory.report, trajectory.report.keyframes
    if report.mode != "full" or keyframes is None:
        return "; ".join(problem.text for problem in report.problems) or "the fixes alone"
    found = report.identified
    R_bs = np.array(found["R_bs"].value)
    velocity_latency = _number(found["gps_velocity_latency"].value)
    inside = np.flatnonzero(keyframes.t >= window.imu.t[0] + 0.05)
    if inside.size < 10:
        return "the window is too short"
    k = int(inside[0])
    arm_b = np.array(found["lever_arm_b"].value)
    unseen = np.zeros(3) if keyframes.unseen_offset is None else keyframes.unseen_offset
    return LagStart(
        float(keyframes.t[k]),
        keyframes.R_nb[k] @ R_bs,
        keyframes.position_n[k] - keyframes.R_nb[k] @ arm_b,
        keyframes.velocity_n[k],
        keyframes.accel_bias_s[k],
        keyframes.gyro_bias_s[k],
        R_bs,
        np.array(found["R_bs"].sigma),
        _number(found["gps_position_latency"].value),
        velocity_latency,
        R_bs.T @ arm_b,
        InertialNoise(
            _number(found["accel_noise"].value),
            _number(found["gyro_noise"].value),
            GraphOptions().accel_bias_walk,
            GraphOptions().gyro_bias_walk,
        ),
        np.array(found["gps_position_noise"].value),
        np.array(found["gps_velocity_noise"].value),
        np.sqrt(np.array(found["gps_offset_sigma"].value) ** 2 - unseen),
        _number(found["gps_offset_tau"].value),
        unseen,
    )


def find_line(t: Array, position_n: Array, velocity_n: Array, given: GivenLines | None) -> Line | None:
    """Return the start line of the laps driven, None without a loop. t (N,) s; position_n, velocity_n (N, 3)."""
    path = PlanPath(t, position_n[:, :2], velocity_n[:, :2], position_n[:, 2])
    try:
        circuit = find_circuit(path, given, None, SHORTEST_LAP, np.zeros(len(t), dtype=np.bool_))
    except (SmootherError, ValueError, IndexError):
        return None
    return None if isinstance(circuit, Problem) else circuit.start_line


def _number(value: object) -> float:
    assert isinstance(value, float)
    return value


class Job(Protocol[T_co]):
    """Work that was asked for; text where it failed."""

    def done(self) -> bool:
        """Whether there is a result."""
        ...

    def result(self) -> T_co | str:
        """Return it. Only once it is done."""
        ...


@dataclass(frozen=True, eq=False)
class Done(Generic[T_co]):
    """Work that is done."""

    value: T_co

    def done(self) -> bool:
        """It is."""
        return True

    def result(self) -> T_co:
        """Return it."""
        return self.value


class Foreground:
    """A Worker that does it at once: for tests and for playing a file as fast as it goes."""

    def identify(self, window: Window) -> Job[LagStart | str]:
        """Run :func:`identify`."""
        return Done(identify(window))

    def find_line(self, t: Array, position_n: Array, velocity_n: Array, given: GivenLines | None) -> Job[Line | None]:
        """Run :func:`find_line`."""
        return Done(find_line(t, position_n, velocity_n, given))
