"""Score a smoothed simulation: errors against truth beside the information bound, coverage of its sigmas, NEES.

Shared by the benchmarks. Angles are in degrees here, because everything ends in a table that people read.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from bound import (
    RELATIVE_INTERVAL,
    Bound,
    BoundOptions,
    BoundRms,
    information_bound,
    scored_span,
    within,
)
from smoother import api, so3
from smoother.arrays import Array, BoolArray
from smoother.frames import euler_from_rotation, wrap_angle
from smoother.samples import Session
from smoother.sim.scenario import with_changes
from smoother.sim.sensors import mean_motion
from smoother.sim.simulation import Simulation
from smoother.trajectory import Identified, Trajectory
from smoother.units import DEG

if TYPE_CHECKING:
    from smoother.api import Errors

TRACKS = ("larkfield", "tinbarn", "longmeadow")
STANDING = 5.0  # s on the grid of a standing start
SCORED_RATE = 10.0  # Hz; errors change more slowly
GAP, GAP_MARGIN = 1.5, 1.0  # s; a longer time without fix is an outage; it is left out with this much on either side
NEES_EVERY = 60.0  # s between the fixed times
HARD_CORNER = 10.0  # m/s^2 of lateral acceleration, at which slip_sigma is what the process has
NEAREST_OFFSET = 0.3  # s; farther from a fix the true offset is not known
ANGLES = ("roll", "pitch", "yaw")
QUANTITIES = ("velocity", "relative", *ANGLES)


@dataclass(frozen=True)
class Case:
    """Which session: preset, seed, track, length in s, whether it begins standing on the grid, figures changed."""

    preset: str
    seed: int
    track: str
    duration: float
    standing: bool
    changes: Mapping[str, Any] = field(default_factory=dict)

    @property
    def name(self) -> str:
        """Short name for tables."""
        return f"{self.preset}-{self.seed} {self.track} {'standing' if self.standing else 'rolling'}"

    def simulate(self) -> Simulation:
        """Return the session; white keeps its 30 s of standstill, which its figures are about."""
        standstill = {"motion_standstill": STANDING if self.standing else None}
        changes = self.changes if self.preset == "white" and self.standing else {**standstill, **self.changes}
        return api.simulate(self.preset, self.seed, track=self.track, duration=self.duration, **changes)


def cases(preset: str, seeds: range, duration: float, *, grid: bool = False) -> list[Case]:
    """Return the sessions of a preset: one for each seed, tracks and starts in turn; with `grid` every combination."""
    if grid:
        return [
            Case(preset, seed, track, duration, start) for seed in seeds for track in TRACKS for start in (True, False)
        ]
    return [Case(preset, seed, TRACKS[seed % 3], duration, seed % 2 == 0) for seed in seeds]


def recorded(simulation: Simulation) -> Session:
    """Return the session as it comes from a file: stamps evened, fixes at the receiver's own times, calibrated."""
    return api.prepared(simulation.raw, even_times=True)


@dataclass(frozen=True)
class ValueScore:
    """An identified value: the truth, its error, what the estimator says of it, and the bound (None: there is none)."""

    true: float
    error: float
    sigma: float
    bound: float | None
    observable: bool
    is_other: bool = False  # than delays, arm and mounting

    @property
    def z(self) -> float:
        """Error in the estimator's own sigmas."""
        return self.error / self.sigma if self.sigma > 0.0 else np.nan


@dataclass(frozen=True)
class NeesAt:
    """Normalised errors squared at one time s: of everything (9), and of attitude, velocity, position (3 each)."""

    t: float
    full: float
    attitude: float
    velocity: float
    position: float


@dataclass(frozen=True)
class Score:
    """Everything measured about one session. rms and bound: m/s, m, deg by name; values: s, m, deg.

    rms also has sensor_roll, .. : the attitude without the error of the mounting, which the bound takes as known.
    coverage : name -> shares within one and two sigma. noise : identified over effective densities and sigmas.
    """

    case: Case
    mode: str
    seconds: float
    rms: dict[str, float]
    bound: dict[str, float]
    values: dict[str, ValueScore]
    coverage: dict[str, tuple[float, float]]
    nees: list[NeesAt]
    noise: dict[str, float]
    problems: list[str]


@dataclass(frozen=True)
class ScoreOptions:
    """full_bound: the bound also counts engine tone and unknown scale factors. outages: they count."""

    full_bound: bool = False
    outages: bool = True


def score(
    case: Case, simulation: Simulation, session: Session, estimate: Trajectory, seconds: float, options: ScoreOptions
) -> Score:
    """Return the score of `estimate`, which took `seconds`."""
    start, end = span_of(simulation, estimate)
    compared = compare(simulation, session, estimate, SCORED_RATE)
    left_out = () if options.outages else outages(simulation)
    inside = within(compared.t, start, end, left_out)
    density = effective_density(simulation)
    bounds = bound_of(simulation, density if options.full_bound else None)
    bound = bounds.rms(start, end, left_out)
    limits = {**_bound_figures(bound), "track": bounds.rms(start, end, outages(simulation)).track}
    return Score(
        case,
        estimate.report.mode,
        seconds,
        rms_errors(simulation, compared, inside),
        limits,
        {
            **_values(simulation, estimate.report.identified, bound),
            **_other_values(simulation, estimate.report.identified, density),
        },
        {name: _shares(e[inside], s[inside]) for name, (e, s) in _sigma_pairs(compared).items()},
        nees_at_times(simulation, session, estimate),
        _noise(simulation, estimate.report.identified, density),
        [p.code for p in estimate.report.problems],
    )


@dataclass(frozen=True, eq=False)
class Compared:
    """Estimate beside truth at t (N,) s: errors, also of position plus GPS offset (N, 2) m, None without an offset."""

    t: Array
    truth: Trajectory
    found: Trajectory
    errors: "Errors"
    track: Array | None


def compare(simulation: Simulation, session: Session, estimate: Trajectory, rate: float) -> Compared:
    """Return `estimate` beside the truth at `rate` Hz, over all that counts."""
    t = np.arange(*span_of(simulation, estimate), 1.0 / rate)
    truth = simulation.truth.trajectory(t, simulation.scenario.lever_arm_b, session.origin)
    found = api.resample(estimate, t)
    track = _track_errors(simulation, estimate, t, truth, found)
    return Compared(t, truth, found, api.errors_between(found, truth), track)


def rms_errors(simulation: Simulation, compared: Compared, inside: BoolArray | None = None) -> dict[str, float]:
    """Root mean squares, m/s, m and deg, over the rows `inside` (N,) or all; QUANTITIES, position, track, sensor_.."""
    errors = compared.errors
    inside = np.full(len(compared.t), True) if inside is None else inside
    euler = errors.euler[inside] / DEG
    sensor = _sensor_errors(simulation, compared.found, compared.truth)[inside] / DEG
    return {
        "velocity": rms(np.linalg.norm(errors.velocity_n[inside, :2], axis=1)),
        "relative": _relative(errors.position_n[:, :2], inside),
        **{name: rms(euler[:, i]) for i, name in enumerate(ANGLES)},
        **{f"sensor_{name}": rms(sensor[:, i]) for i, name in enumerate(ANGLES)},
        "position": rms(np.linalg.norm(errors.position_n[inside, :2], axis=1)),
        "track": np.nan if compared.track is None else rms(compared.track[inside]),
    }


def span_of(simulation: Simulation, estimate: Trajectory) -> tuple[float, float]:
    """Return first and last time s that count: both truth and estimate are there, and the kart has driven a while."""
    start, end = scored_span(simulation)
    return max(start, float(estimate.t[0])), min(end, float(estimate.t[-1]))


def normalised_errors(simulation: Simulation, session: Session, estimate: Trajectory, rate: float) -> dict[str, Array]:
    """Errors over their reported sigmas by quantity, (N, c) at `rate` Hz, NaN where unknown; no bound is computed."""
    compared = compare(simulation, session, estimate, rate)
    pairs = _sigma_pairs(compared)
    return {name: (error / sigma).reshape(len(compared.t), -1) for name, (error, sigma) in pairs.items()}


def outages(simulation: Simulation) -> list[tuple[float, float]]:
    """Return the stretches (start, end) s without fixes, jumps being none, and a margin around them."""
    gnss = simulation.gnss
    good = gnss.position_time[~np.any(gnss.jump_n != 0.0, axis=1)]
    before = np.flatnonzero(np.diff(good) > GAP)
    return [(float(good[i]) - GAP_MARGIN, float(good[i + 1]) + GAP_MARGIN) for i in before]


def _relative(error: Array, inside: BoolArray) -> float:
    """Horizontal rms (m) of the error of the change of position over a second, both of whose ends count."""
    n = round(RELATIVE_INTERVAL * SCORED_RATE)
    both = inside[:-n] & inside[n:]
    return rms(np.linalg.norm(error[n:] - error[:-n], axis=1)[both])


def _sensor_errors(simulation: Simulation, found: Trajectory, truth: Trajectory) -> Array:
    """Errors (N, 3) rad of roll, pitch, yaw as if the mounting were known."""
    mounting = found.report.identified.get("R_bs")
    if mounting is None:
        return np.full((len(found), 3), np.nan)
    R_bb = np.asarray(mounting.value) @ simulation.scenario.R_bs.T  # true body axes to those found
    roll, pitch, yaw = euler_from_rotation(found.R_nb @ R_bb)
    return wrap_angle(np.stack([roll, pitch, yaw], axis=-1) - truth.euler)


def bound_of(simulation: Simulation, density: tuple[float, float] | None) -> Bound:
    """Return the bound; with effective densities, of an estimator that does not know scale factors either."""
    if density is None:
        return information_bound(simulation)
    changes = {"imu_accel_noise": density[0], "imu_gyro_noise": density[1]}
    changed = replace(simulation, scenario=with_changes(simulation.scenario, changes))
    return information_bound(changed, BoundOptions(imu_matrix=True))


def effective_density(simulation: Simulation, block: float = 0.2) -> tuple[float, float]:
    """Density of force and rate by the scatter of means over `block` s: white noise and what folds of the engine."""
    imu, errors, R_bs = simulation.imu, simulation.scenario.imu, simulation.scenario.R_bs
    assert imu is not None and errors is not None
    ideal = (m @ R_bs for m in mean_motion(simulation.truth, imu.true_time - errors.latency, 1.0 / errors.rate))
    n = round(block * errors.rate)
    out = []
    for true, matrix, bias, counts, scale in zip(
        ideal,
        (errors.accel_matrix, errors.gyro_matrix),
        (imu.accel_bias_s, imu.gyro_bias_s),
        (imu.raw.accel, imu.raw.gyro),
        (imu.raw.accel_scale, imu.raw.gyro_scale),
        strict=True,
    ):
        error = counts * scale - true @ matrix.T - bias
        means = error[: len(error) // n * n].reshape(-1, n, 3).mean(axis=1)
        out.append(float(np.sqrt(np.mean(means**2) * block)))
    return out[0], out[1]


def _bound_figures(bound: BoundRms) -> dict[str, float]:
    return {
        "velocity": bound.velocity,
        "relative": bound.relative,
        "roll": bound.roll / DEG,
        "pitch": bound.pitch / DEG,
        "yaw": bound.yaw / DEG,
        "position": bound.position,
    }


def _track_errors(
    simulation: Simulation, estimate: Trajectory, t: Array, truth: Trajectory, found: Trajectory
) -> Array | None:
    """Error (N, 2) m of position plus offset, NaN away from fixes; None if the estimator has no offset."""
    keyframes = estimate.report.keyframes
    if keyframes is None or keyframes.gps_offset_n is None:
        return None
    gnss = simulation.gnss
    nearest = np.abs(t[:, None] - gnss.position_time[_around(gnss.position_time, t)]).min(axis=1)
    error = found.position_n[:, :2] - truth.position_n[:, :2]
    for i in range(2):
        error[:, i] += np.interp(t, keyframes.t, keyframes.gps_offset_n[:, i])
        error[:, i] -= np.interp(t, gnss.position_time, gnss.offset_n[:, i])
    return np.where(nearest[:, None] < NEAREST_OFFSET, error, np.nan)


def _around(times: Array, t: Array) -> np.ndarray:
    return np.clip(np.searchsorted(times, t)[:, None] + [-1, 0], 0, len(times) - 1)


def _sigma_pairs(compared: Compared) -> dict[str, tuple[Array, Array]]:
    if compared.found.sigmas is None:
        return {}
    s, errors, track = compared.found.sigmas, compared.errors, compared.track
    pairs = {}
    for i, axis in enumerate(("north", "west", "up")):
        pairs[f"pos_{axis}"] = errors.position_n[:, i], s.position_n[:, i]
        pairs[f"vel_{axis}"] = errors.velocity_n[:, i], s.velocity_n[:, i]
    for i, angle in enumerate(ANGLES):
        pairs[angle] = errors.euler[:, i], s.attitude[:, i]
    if track is not None:
        pairs["track"] = track, np.stack([s.track, s.track], axis=1)
    return pairs


def _shares(error: Array, sigma: Array) -> tuple[float, float]:
    known = np.isfinite(error) & np.isfinite(sigma)
    z = np.abs(error[known]) / sigma[known]
    return float(np.mean(z <= 1.0)), float(np.mean(z <= 2.0))


def _values(simulation: Simulation, identified: dict[str, Identified], bound: BoundRms) -> dict[str, ValueScore]:
    scenario, out = simulation.scenario, {}
    for key, true, limit in (
        ("gps_position_latency", scenario.gnss.position_latency, bound.position_latency),
        ("gps_velocity_latency", scenario.gnss.velocity_latency, bound.velocity_latency),
    ):
        if (value := identified.get(key)) is not None:
            out[key] = ValueScore(
                true, float(np.asarray(value.value)) - true, _number(value.sigma), limit, value.observable
            )
    if (arm := identified.get("lever_arm_b")) is not None:
        sigma = np.full(3, np.nan) if arm.sigma is None else np.asarray(arm.sigma, dtype=np.float64)
        error = np.asarray(arm.value, dtype=np.float64) - scenario.lever_arm_b
        for i, axis in enumerate("xyz"):
            out[f"arm_{axis}"] = ValueScore(
                float(scenario.lever_arm_b[i]), error[i], sigma[i], float(bound.lever_arm_b[i]), arm.observable
            )
    if (mounting := identified.get("R_bs")) is not None:
        sigma = np.full(3, np.nan) if mounting.sigma is None else np.asarray(mounting.sigma, dtype=np.float64)
        turn = so3.log(np.asarray(mounting.value) @ scenario.R_bs.T)
        for i, axis in enumerate("xyz"):
            out[f"mount_{axis}"] = ValueScore(0.0, turn[i] / DEG, sigma[i] / DEG, None, mounting.observable)
    return out


def _other_values(
    simulation: Simulation, identified: dict[str, Identified], density: tuple[float, float]
) -> dict[str, ValueScore]:
    """All else that is identified and that the simulation knows: noise, wander, slip, and effects that it has none of.

    density: effective ones of force and rate. What a sigma per axis is of has one figure on the level and one upwards.
    """
    gnss, imu, motion, out = simulation.scenario.gnss, simulation.scenario.imu, simulation.scenario.motion, {}
    assert imu is not None
    mag = simulation.scenario.mag
    slip = HARD_CORNER * motion.slip_per_acceleration * motion.slip_sigma
    for key, true in (
        ("accel_noise", (density[0],)),
        ("gyro_noise", (density[1],)),
        ("gps_position_noise", (gnss.white_horizontal, gnss.white_up)),
        ("gps_velocity_noise", (gnss.velocity_sigma,) if gnss.velocity else ()),
        ("gps_offset_sigma", (gnss.offset_horizontal, gnss.offset_up)),
        ("gps_offset_tau", (gnss.offset_tau,) if gnss.offset_horizontal > 0.0 else ()),
        ("slip_sigma", (slip,)),
        ("gps_velocity_response", (0.0,)),
        ("accel_delay", (imu.accel_delay,)),
        ("mag_hard_iron", () if mag is None else tuple(mag.hard_iron_s)),
        ("mag_soft_iron", () if mag is None else tuple(np.ravel(_correction(mag.soft_iron)))),
        ("mag_heading_offset", (0.0,)),
    ):
        if (value := identified.get(key)) is None or value.source == "configured":
            continue
        found = np.ravel(np.asarray(value.value, dtype=np.float64))
        sigma = np.ravel(np.asarray(value.sigma, dtype=np.float64))
        rows = [0, -1] if len(true) == 2 else range(len(true))
        for name, i, truth in zip(_names(key, len(true)), rows, true, strict=True):
            out[name] = ValueScore(float(truth), float(found[i] - truth), float(sigma[i]), None, value.observable, True)
    return out


def _names(key: str, count: int) -> list[str]:
    """Names of one value, of one on the level and one upwards, or of so many."""
    return [key] if count == 1 else [key, f"{key}_up"] if count == 2 else [f"{key}_{i}" for i in range(count)]


def _correction(soft_iron: Array) -> Array:
    """What takes a field distorted by soft_iron (3, 3) back to what it was but for its strength."""
    return np.asarray(np.linalg.inv(soft_iron) * abs(np.linalg.det(soft_iron)) ** (1.0 / 3.0))


def other_values(scores: Sequence[Score]) -> list[str]:
    """Lines on what is identified beside delays, arm and mounting: error over sigma, and how many sessions show it."""
    names = dict.fromkeys(key for s in scores for key, value in s.values.items() if value.is_other)
    cells = []
    for name in names:
        values = [s.values[name] for s in scores if name in s.values]
        z, shown = np.array([abs(v.z) for v in values]), sum(v.observable for v in values)
        cells.append(f"{name} {rms(z):.2f} (largest {np.nanmax(z):.1f}; shown {shown}/{len(values)})")
    parts = [", ".join(cells[i : i + 3]) for i in range(0, len(cells), 3)]
    return [f"{'' if i else 'other values, z rms:':<21}{part}" for i, part in enumerate(parts)]


def _noise(simulation: Simulation, identified: dict[str, Identified], density: tuple[float, float]) -> dict[str, float]:
    """Identified over true: densities against what the samples really scatter, the others against the scenario."""
    errors, out = simulation.scenario.gnss, {}
    true = {
        "accel_noise": density[0],
        "gyro_noise": density[1],
        "gps_position_noise": errors.white_horizontal,
        "gps_velocity_noise": errors.velocity_sigma,
        "gps_offset_sigma": errors.offset_horizontal,
        "gps_offset_tau": errors.offset_tau,
    }
    for key, value in true.items():
        if key in identified and value > 0.0:
            out[key] = float(np.ravel(np.asarray(identified[key].value, dtype=np.float64))[0]) / value
    return out


def nees_at_times(simulation: Simulation, session: Session, estimate: Trajectory) -> list[NeesAt]:
    """Return the NEES of the keyframes nearest to fixed times, every NEES_EVERY s; none without keyframes."""
    keyframes = estimate.report.keyframes
    if keyframes is None:
        return []
    start, end = span_of(simulation, estimate)
    wanted = np.arange(start, end, NEES_EVERY)
    k = np.clip(np.searchsorted(keyframes.t, wanted), 0, len(keyframes.t) - 1)
    truth = simulation.truth.trajectory(keyframes.t[k], simulation.scenario.lever_arm_b, session.origin)
    turn = so3.log(truth.R_nb @ keyframes.R_nb[k].transpose(0, 2, 1))
    moved = truth.velocity_n - keyframes.velocity_n[k], truth.position_n - keyframes.position_n[k]
    error, P = np.concatenate([turn, *moved], axis=1), keyframes.covariance[k]

    def squared(part: slice) -> Array:
        e = error[:, part, None]
        return np.asarray((e.transpose(0, 2, 1) @ np.linalg.solve(P[:, part, part], e))[:, 0, 0])

    parts = [squared(part) for part in (slice(0, 9), slice(0, 3), slice(3, 6), slice(6, 9))]
    return [NeesAt(float(t), *(float(p[i]) for p in parts)) for i, t in enumerate(wanted)]


def _number(sigma: object) -> float:
    return float(sigma) if isinstance(sigma, int | float) else np.nan


def rms(values: Iterable[float | None] | Array) -> float:
    """Root mean square of those that are known, NaN where none is."""
    numbers = np.array(values if isinstance(values, np.ndarray) else list(values), dtype=np.float64)  # None is NaN
    known = numbers[np.isfinite(numbers)]
    return float(np.sqrt(np.mean(known**2))) if known.size else np.nan
