"""What the smoother models, and how to do without each of it: options, settings, or names replaced for a while."""

import contextlib
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from typing import Any
from unittest.mock import patch

import numpy as np

from smoother.arrays import Array, BoolArray
from smoother.config import ImuNoise
from smoother.estimate import align
from smoother.estimate.clock_offset import NO_OFFSET, ClockOffset
from smoother.estimate.clocks import UNSEEN_DRIFT, ClockDrift
from smoother.estimate.gnss_offset import OffsetModel
from smoother.estimate.gnss_turned import NOTHING, Disagreement
from smoother.estimate.graph import (
    batch,
    begin,
    components,
    dense_rows,
    expected,
    first_noise,
    imu,
    inertial,
    looks,
    options,
    output,
    session_rows,
    smoother,
    solve,
    start,
)
from smoother.estimate.graph.chain import ChainSystem
from smoother.estimate.graph.claims import ALIKE, Claims
from smoother.estimate.graph.expected import ExpectedMotion, Motion
from smoother.estimate.graph.felt import Felt
from smoother.estimate.graph.first_noise import DATA_SHEET_ACCEL, DATA_SHEET_GYRO
from smoother.estimate.graph.imu import BinnedImu, DensePath
from smoother.estimate.graph.inertial_noise import ROUND, InertialNoise, Shape
from smoother.estimate.graph.inputs import SENSOR_ERRORS, Priors
from smoother.estimate.graph.keyframes import keyframe_times
from smoother.estimate.graph.mounting import FittedMounting
from smoother.estimate.graph.normal_equations import add_constants_prior
from smoother.estimate.graph.row_components import RowComponent
from smoother.estimate.graph.smoother import GraphOptions, GraphSmoother
from smoother.estimate.graph.state import ACCEL_ERROR, GYRO_ERROR, RECTIFICATION
from smoother.fit.running import gaussian_mean
from smoother.samples import GnssFixes, ImuSamples, Session
from smoother.trajectory import Trajectory

OFF = 1e-6  # a sigma that leaves nothing to find
TINY = 1e-3  # m, likewise of an offset, of which there is one at every keyframe: less spoils the arithmetic
EQUAL = 1e-5  # s, sigma of the difference of latencies that are to be one
Patch = tuple[Any, str, Any]


@dataclass(frozen=True)
class Effect:
    """Something modelled, and how to do without: other options, another session, or names replaced in modules."""

    name: str
    options: dict[str, Any] = field(default_factory=dict)
    session: Callable[[Session], Session] | None = None
    patches: tuple[Patch, ...] = ()

    def estimate(self, session: Session) -> Trajectory:
        """Return the trajectory without the effect."""
        given = session if self.session is None else self.session(session)
        with _patched(self.patches):
            return GraphSmoother(GraphOptions(**self.options)).estimate(given)


@contextlib.contextmanager
def _patched(patches: Sequence[Patch]) -> Iterator[None]:
    """Replace names in modules for a while. Raises AttributeError for a name that is no longer there."""
    with contextlib.ExitStack() as stack:
        for module, name, replacement in patches:
            stack.enter_context(patch.object(module, name, replacement))
        yield


def _timing(session: Session) -> Session:
    config = session.config
    gps = replace(config.gps, position_latency=0.0, velocity_latency=0.0)
    return replace(session, config=replace(config, gps=gps))


def _no_arm(session: Session) -> Session:
    mounting = replace(session.config.mounting, lever_arm_b=np.zeros(3))
    return replace(session, config=replace(session.config, mounting=mounting))


def _data_sheet(session: Session) -> Session:
    noise = ImuNoise(DATA_SHEET_ACCEL, DATA_SHEET_GYRO)
    return replace(session, config=replace(session.config, imu=noise))


def _no_magnetometer(session: Session) -> Session:
    return replace(session, mag=None)


def _no_reports(session: Session) -> Session:
    gnss = replace(session.gnss, sigma_horizontal=None, sigma_up=None, sigma_velocity=None, hdop=None)
    return replace(session, gnss=gnss)


def _one_latency() -> tuple[Patch, ...]:
    """Start the latencies alike, and hold their difference by a factor of its own."""
    priors, add = start._priors, add_constants_prior

    def same_start(*given: Any) -> Priors:
        found = priors(*given)
        mean = found.constants.copy()
        mean[0] = mean[1]
        return replace(found, constants=mean)

    def held_together(system: ChainSystem, residual: Array, sigma: Array) -> None:
        add(system, residual, sigma)
        weight, apart = EQUAL**-2, residual[1] - residual[0]
        system.corner[:2, :2] += weight * np.array([[1.0, -1.0], [-1.0, 1.0]])
        system.rhs_constants[:2] -= weight * apart * np.array([-1.0, 1.0])

    return ((start, "_priors", same_start), (batch, "add_constants_prior", held_together))


def _rough_mounting(_: Any, rough_R_bs: Array, *__: Any) -> FittedMounting:
    return FittedMounting(rough_R_bs, np.full(3, 0.05), False)


def _none_left_out(session: Session, *_: Any) -> BoolArray:
    return np.zeros(len(session.gnss), dtype=np.bool_)


def _agrees(_: Session) -> Disagreement:
    return NOTHING


def _one_pace(*_: Any, **__: Any) -> ClockDrift:
    return UNSEEN_DRIFT


def _are_quick(_: Array) -> bool:
    return False


def _one_receiver(_: GnssFixes) -> Claims:
    return ALIKE


def _no_other(*_: Any) -> None:
    return None


def _one_time(*_: Any) -> ClockOffset:
    return NO_OFFSET


def _all_count(solved: Any, name: str, _: BoolArray) -> RowComponent:
    return RowComponent.of(solved.rows[name], solved.solution)


def _same(value: Any, *_: Any) -> Any:
    return value


def _same_everywhere(*_: Any) -> None:
    return None


def _usual_walks(_: Any, noise: InertialNoise, *_usual: Any) -> InertialNoise:
    return noise


def _one_by_one(*_: Any) -> float:
    return 1.0


def _no_ratio(*_: Any) -> Array:
    return np.ones(3)


def _no_share(*_: Any) -> float:
    return 0.0


def _bounds_without(*parts: slice) -> tuple[Array, Array]:
    """Bounds of the spreads of sensor errors that leave nothing to find of those at `parts` of the constants."""
    off = np.array([part in parts for part in SENSOR_ERRORS])
    low, high = (np.where(off, OFF, bound) for bound in components.SENSOR_ERROR)
    return low, high


def _as_round(*_: Any) -> Shape:
    return ROUND


def _wherever(begin: float, end: float, interval: float, _: Array | None = None) -> Array:
    return keyframe_times(begin, end, interval)


def _all_shown(_: float) -> float:
    """Slopes of all that keyframes follow."""
    return expected.DRIVEN_BELOW


def _all_left(frequency: Array, *_: Any) -> Array:
    return np.ones(len(frequency))


def _no_doppler(*_: Any) -> None:
    return None


def _nothing_quick(_: Any) -> float:
    return 0.0


def _usual_offset(_: Array, __: Any, usual: OffsetModel, *___: Any) -> OffsetModel:
    return usual


def _as_given(_: Any, sigma: Array, *__: Any) -> Array:
    return sigma


def _never_still(session: Session, **_: Any) -> Array:
    assert session.imu is not None
    return np.zeros(len(session.imu.t), dtype=bool)


def _unaveraged(path: DensePath, *_: Any, **__: Any) -> ExpectedMotion:
    def at_edges(values: Array) -> Array:
        return np.concatenate([values[:1], 0.5 * (values[1:] + values[:-1]), values[-1:]])

    turning = np.sum(path.R_ns[:-1, 2, :] * path.angular_rate_s, axis=1)
    return ExpectedMotion(path.velocity_n, at_edges(path.acceleration_n), at_edges(turning))


def _raw_upwards(path: DensePath, *arguments: Any, **named: Any) -> ExpectedMotion:
    """What is expected, but up and down as the samples say."""
    felt = expected.expected_motion(path, *arguments, **named)
    raised = _upwards_as_felt(felt, path)
    followed = None if felt.followed is None else _upwards_as_felt(felt.followed, path)
    return replace(felt, velocity_n=raised.velocity_n, acceleration_n=raised.acceleration_n, followed=followed)


def _upwards_as_felt(motion: Motion, path: DensePath) -> Motion:
    velocity_n, acceleration_n = motion.velocity_n.copy(), motion.acceleration_n.copy()
    velocity_n[:, 2], acceleration_n[:, 2] = path.velocity_n[:, 2], expected.at_edges(path.acceleration_n)[:, 2]
    return Motion(velocity_n, acceleration_n, motion.turn_rate)


def _averaged_rates(path: DensePath, *_: Any, **__: Any) -> Felt:
    """Rates and accelerations averaged over a tenth of a second, as sure as if they were the truth."""
    rate_s, acceleration_n = (
        expected.at_edges(gaussian_mean(values, 0.05 / (path.t[1] - path.t[0])))
        for values in (path.angular_rate_s, path.acceleration_n)
    )
    return Felt(path, acceleration_n, np.einsum("kij,kj->ki", path.R_ns, rate_s), 0.0, 0.0)


def _not_missed(samples: ImuSamples, t: Array, n_bins: int, *others: Any) -> BinnedImu:
    """Bins with what was made up passed off as measured."""
    binned = imu.bin_imu(samples, t, n_bins, *others)
    return replace(binned, missing=np.zeros_like(binned.missing))


def _plain_bins(samples: ImuSamples, t: Array, n_bins: int, *others: Any) -> BinnedImu:
    """Means of the components of force and rate, as if the box did not turn within a bin."""
    binned = imu.bin_imu(samples, t, n_bins, *others)
    step = np.diff(samples.t, prepend=samples.t[0])[:, None]
    out = []
    for values in (samples.specific_force_s, samples.angular_rate_s):
        total = np.cumsum(values * step, axis=0)
        at = np.stack([np.interp(binned.edges, samples.t, total[:, i]) for i in range(3)], axis=1)
        out.append((np.diff(at, axis=0) / binned.dt).reshape(binned.specific_force_s.shape))
    return replace(binned, specific_force_s=out[0], angular_rate_s=out[1])


def _plain_halves(binned: BinnedImu, _: Array) -> BinnedImu:
    force, rate = (
        0.5 * (values[:, 0::2] + values[:, 1::2]) for values in (binned.specific_force_s, binned.angular_rate_s)
    )
    return replace(binned, dt=2.0 * binned.dt, specific_force_s=force, angular_rate_s=rate)


_NO_OFFSET = {"offset_sigma": (TINY, TINY, TINY)}
EFFECTS = (
    Effect("velocity latency of its own", patches=_one_latency()),
    Effect("latencies at all", session=_timing),
    Effect("accelerometer delay", options={"in_step": False}),
    Effect("wheels that roll along", options={"wheels": False}),
    Effect("lever arm", session=_no_arm),
    Effect(
        "arm that stays with the kart, box on the wheel",
        patches=(
            (start, "is_on_wheel", lambda *_: False),
            (start, "turns_with_bends", lambda *_: False),
            (smoother, "_turns_with_a_wheel", lambda *_: False),
        ),
    ),
    Effect("mounting refined", patches=((smoother, "fit_mounting", _rough_mounting),)),
    Effect("GPS offset", options=_NO_OFFSET, patches=((components, "_offset_ratio", _no_ratio),)),
    Effect("GPS offset's sigma identified", patches=((components, "_offset_ratio", _no_ratio),)),
    Effect("wander of Doppler", patches=((output, "share_wander", _same),)),
    Effect("GPS offset's tau (20 s in place of 60 s)", options={"offset_tau": 20.0}),
    Effect("inertial noise identified (data sheet)", session=_data_sheet),
    Effect(
        "noise of the fixes identified",
        patches=((components, "_row_sigma", _as_given), (solve, "doppler_noise", _no_doppler)),
    ),
    Effect("noise of velocity and force found together", patches=((solve, "doppler_noise", _no_doppler),)),
    Effect("attitudes turn the expected force", patches=((inertial, "as_expected", _same),)),
    Effect(
        "scale and misalignment",
        options={"sensor_error_sigma": OFF},
        patches=((components, "SENSOR_ERROR", _bounds_without(ACCEL_ERROR, GYRO_ERROR)),),
    ),
    Effect(
        "rectified vibration",
        options={"rectification_sigma": OFF},
        patches=((components, "SENSOR_ERROR", _bounds_without(RECTIFICATION)),),
    ),
    Effect("walk of the biases", options={"accel_bias_walk": OFF, "gyro_bias_walk": OFF}),
    Effect("bias of the Doppler", options={"doppler_bias_sigma": OFF}),
    Effect("response of the Doppler", options={"velocity_response_sigma": 1e-3 * OFF}),
    Effect("shape of what the Doppler filters", options={"evenness_sigma": 1e-3 * OFF}),
    Effect("slopes of what the receiver shows", patches=((session_rows, "shown_below", _all_shown),)),
    Effect("noise that the receiver filtered", patches=((components, "passed_noise", _same_everywhere),)),
    Effect("magnetometer", session=_no_magnetometer),
    Effect("robust weights", patches=((session_rows, "robust", _same),)),
    Effect("standstill", patches=((start, "session_standstill", _never_still),)),
    Effect("expected rate and acceleration at the antenna", patches=((session_rows, "expected_motion", _unaveraged),)),
    Effect(
        "motion up and down freed of the samples' noise", patches=((session_rows, "expected_motion", _raw_upwards),)
    ),
    Effect("most probable rates in the rows", patches=((dense_rows, "felt_on", _averaged_rates),)),
    Effect("two fixes to a keyframe beyond 10 Hz", patches=((options, "FIXES_BETWEEN", 1000),)),
    Effect("what Doppler takes of the samples' noise", patches=((expected, "noise_left", _all_left),)),
    Effect("noise of the turn rate from where no kart turns", patches=((expected, "quick_scatter", _nothing_quick),)),
    Effect("keyframes where velocities were felt", patches=((start, "keyframe_times", _wherever),)),
    Effect("noise that follows the vibration", patches=((components, "_share", _no_share),)),
    Effect("force noisier in places", patches=((components, "local_level", _same_everywhere),)),
    Effect("walks of the biases as the session shows", patches=((solve, "bias_walks", _usual_walks),)),
    Effect("noise of each direction its own", patches=((components, "_shape", _as_round),)),
    Effect("GPS offset as the fixes show it beforehand", patches=((first_noise, "offset_model", _usual_offset),)),
    Effect("more noise where samples miss", patches=((start, "bin_imu", _not_missed),)),
    Effect("what velocities at rest have in common", patches=((start, "scale_at_rest", _one_by_one),)),
    Effect("velocities that err for a while", patches=((start, "lasting_at_rest", lambda *_: 0.0),)),
    Effect("reported accuracies", session=_no_reports),
    Effect("receivers that go straight on", patches=((begin, "coasting", _none_left_out),)),
    Effect("receivers that have not settled", patches=((begin, "unsettled", _none_left_out),)),
    Effect("velocities turned against positions", patches=((smoother, "disagreement", _agrees),)),
    Effect("drift of the clocks", patches=((begin, "clock_drift", _one_pace),)),
    Effect("clocks that show different times", patches=((begin, "clock_offset", _one_time),)),
    Effect("course later than speed", patches=((looks, "for_late_course", _no_other),)),
    Effect("alignment by changes between rare fixes", patches=((align, "are_rare", _are_quick),)),
    Effect("corrections that come and go", patches=((start, "claims_of", _one_receiver),)),
    Effect("noise of the fixes from driving alone", patches=((components, "_component_of", _all_count),)),
    Effect("rotation-aware averaging", patches=((start, "bin_imu", _plain_bins), (start, "halved", _plain_halves))),
)
FULL = Effect("everything on")
BY_NAME = {effect.name: effect for effect in (FULL, *EFFECTS)}
