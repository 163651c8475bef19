"""Each effect that the smoother models, switched off alone: what does it cost, beyond the spread of seeds?

    SMOOTH_DATA=../shared/data python benchmarks/ablations.py --results ablations.jsonl

Every case (a simulated session, a recording with fixes left out, two modules in one car) is estimated with everything
on, and with each effect off; a difference is paired, case by case. For simulated sessions it is that of the error
against truth, for recordings that at the dropped fixes or between the two modules, in blocks of time in place of
seeds. A change stands in the table in per cent with a hundred times the standard error of its logarithm; it counts
(bold) when Student's t says that chance would show it once in CHANCE. The switches are options and settings where
there are any, else patches made here for the length of a run: the product has no knobs for what nobody should turn.

Results are kept in a file of lines, so that a stopped run goes on where it was; --report prints the tables again.
"""

import argparse
import contextlib
import json
import os
import sys
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any
from unittest.mock import patch

os.environ.setdefault("OMP_NUM_THREADS", "1")  # one process per core; before numpy is imported
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np
from scipy.stats import t as student
from scoring import SCORED_RATE, Case, cases, compare, normalised_errors, recorded, rms_errors
from thinning import DATA, read_estimate, scored, thin
from twins import differ, twin_sessions

from smoother.arrays import Array
from smoother.config import ImuNoise
from smoother.estimate.gnss_offset import OffsetModel
from smoother.estimate.graph import batch, imu, rows, smoother, start
from smoother.estimate.graph.chain import ChainSystem
from smoother.estimate.graph.expected import ExpectedMotion
from smoother.estimate.graph.imu import BinnedImu, DensePath
from smoother.estimate.graph.mounting import FittedMounting
from smoother.estimate.graph.smoother import GraphOptions, GraphSmoother
from smoother.estimate.resample import position_at
from smoother.frames import nwu_to_geodetic
from smoother.prepare import prepare
from smoother.samples import ImuSamples, Session
from smoother.session.load import load_raw
from smoother.sim.simulation import Simulation
from smoother.trajectory import Trajectory
from smoother.units import DEG

CHANCE = 200  # once in so many: of the some hundred cells of all tables, two are bold by chance
WORTH_A_WORD = 0.02  # of the logarithm of an error
OFF = 1e-6  # a sigma that leaves nothing to find
TINY = 1e-3  # m, likewise of an offset, of which there is one at every keyframe: less spoils the arithmetic
EQUAL = 1e-5  # s, sigma of the difference of latencies that are to be one
BLOCKS = 8  # of a recording, in place of seeds
RECORDINGS = ("kart_adria_first_half", "kart_lignano_racebox")
HORIZONTAL = ("velocity", "relative", "roll", "pitch", "yaw", "track", "position", "arm", "latency")
HEADINGS = ("velocity", "1 s position", "roll", "pitch", "yaw", "track", "position", "arm", "latency")
SIGMAS = {"velocity": ("vel_north", "vel_west"), "position": ("pos_north", "pos_west"), "yaw": ("yaw",)}
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


# ---- how to do without ----------------------------------------------------------------------------------------------


def _timing(session: Session) -> Session:
    config = session.config
    gps = replace(config.gps, position_latency=0.0, velocity_latency=0.0)
    return replace(session, config=replace(config, gps=gps))


def _no_arm(session: Session) -> Session:
    mounting = replace(session.config.mounting, lever_arm_b=np.zeros(3))
    return replace(session, config=replace(session.config, mounting=mounting))


def _data_sheet(session: Session) -> Session:
    noise = ImuNoise(start.DATA_SHEET_ACCEL, start.DATA_SHEET_GYRO)
    return replace(session, config=replace(session.config, imu=noise))


def _no_magnetometer(session: Session) -> Session:
    return replace(session, mag=None)


def _no_reports(session: Session) -> Session:
    gnss = replace(session.gnss, sigma_horizontal=None, sigma_up=None, sigma_velocity=None, hdop=None)
    return replace(session, gnss=gnss)


def _one_latency() -> tuple[Patch, ...]:
    """Start the latencies alike, and hold their difference by a factor of its own."""
    priors, add = start._priors, rows.add_constants_prior

    def same_start(*given: Any) -> batch.Priors:
        found = priors(*given)
        mean = found.constants.copy()
        mean[0] = mean[1]
        return replace(found, constants=mean)

    def held_together(system: ChainSystem, residual: Array, sigma: Array) -> None:
        add(system, residual, sigma)
        weight, apart = EQUAL**-2, residual[1] - residual[0]
        system.corner[:2, :2] += weight * np.array([[1.0, -1.0], [-1.0, 1.0]])
        system.rhs_constants[:2] -= weight * apart * np.array([-1.0, 1.0])

    return ((start, "_priors", same_start), (rows, "add_constants_prior", held_together))


def _rough_mounting(state: Any, rough_R_bs: Array) -> FittedMounting:
    return FittedMounting(rough_R_bs, np.full(3, 0.05), False)


def _same(value: Any, *_: Any) -> Any:
    return value


def _no_ratio(_: Any) -> Array:
    return np.ones(3)


def _no_share(*_: Any) -> float:
    return 0.0


def _usual_offset(_: Array, __: Any, usual: OffsetModel, *___: Any) -> OffsetModel:
    return usual


def _as_given(_: Any, __: Any, sigma: Array, *___: Any) -> Array:
    return sigma


def _never_still(session: Session) -> Array:
    assert session.imu is not None
    return np.zeros(len(session.imu.t), dtype=bool)


def _unaveraged(path: DensePath, *_: Any) -> ExpectedMotion:
    def at_edges(values: Array) -> Array:
        return np.concatenate([values[:1], 0.5 * (values[1:] + values[:-1]), values[-1:]])

    turning = np.sum(path.R_ns[:-1, 2, :] * path.angular_rate_s, axis=1)
    return ExpectedMotion(at_edges(path.acceleration_n), at_edges(turning))


def _not_missed(samples: ImuSamples, t: Array, n_bins: int, *biases: Array) -> BinnedImu:
    """Bins with what was interpolated passed off as measured."""
    binned = imu.bin_imu(samples, t, n_bins, *biases)
    return replace(binned, missing=np.zeros_like(binned.missing))


def _plain_bins(samples: ImuSamples, t: Array, n_bins: int, *biases: Array) -> BinnedImu:
    """Means of the components of force and rate, as if the box did not turn within a bin."""
    binned = imu.bin_imu(samples, t, n_bins, *biases)
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
    Effect("lever arm", session=_no_arm),
    Effect("mounting refined", patches=((smoother, "fit_mounting", _rough_mounting),)),
    Effect("GPS offset", options=_NO_OFFSET, patches=((batch, "_offset_ratio", _no_ratio),)),
    Effect("GPS offset's sigma identified", patches=((batch, "_offset_ratio", _no_ratio),)),
    Effect("GPS offset's tau (20 s in place of 60 s)", options={"offset_tau": 20.0}),
    Effect("inertial noise identified (data sheet)", session=_data_sheet),
    Effect("noise of the fixes identified", patches=((batch, "_row_sigma", _as_given),)),
    Effect(
        "scale and misalignment",
        options={"sensor_error_sigma": OFF},
        patches=((batch, "SENSOR_ERROR", (OFF, OFF)),),
    ),
    Effect("walk of the biases", options={"accel_bias_walk": OFF, "gyro_bias_walk": OFF}),
    Effect("bias of the Doppler", options={"doppler_bias_sigma": OFF}),
    Effect("magnetometer", session=_no_magnetometer),
    Effect("robust weights", patches=((batch, "_robust", _same),)),
    Effect("standstill", patches=((start, "session_standstill", _never_still),)),
    Effect("expected rate and acceleration at the antenna", patches=((batch, "expected_motion", _unaveraged),)),
    Effect("noise that follows the vibration", patches=((batch, "_share", _no_share),)),
    Effect("GPS offset as the fixes show it beforehand", patches=((start, "offset_model", _usual_offset),)),
    Effect("more noise where samples miss", patches=((start, "bin_imu", _not_missed),)),
    Effect("reported accuracies", session=_no_reports),
    Effect("rotation-aware averaging", patches=((start, "bin_imu", _plain_bins), (start, "halved", _plain_halves))),
)
FULL = Effect("everything on")
BY_NAME = {effect.name: effect for effect in (FULL, *EFFECTS)}


# ---- cases and results ----------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class World:
    """What a group of simulated sessions is like: a preset, figures changed, and what befalls the fixes afterwards."""

    preset: str
    changes: dict[str, Any] = field(default_factory=dict)
    befalls: Callable[[Session, int], Session] | None = None


def _poor_sky(session: Session, seed: int) -> Session:
    """Under trees for 12 s three times: fixes ten times as noisy, and the receiver says so."""
    rng, gnss, origin = np.random.default_rng(9000 + seed), session.gnss, session.origin
    starts = gnss.t[0] + (gnss.t[-1] - gnss.t[0]) * (0.25 + 0.25 * np.arange(3))
    poor = np.any([(gnss.t > start) & (gnss.t < start + 12.0) for start in starts], axis=0)
    noise_n = poor[:, None] * rng.normal(size=(len(gnss.t), 3)) * [2.0, 2.0, 4.0]
    lat, lon, alt = nwu_to_geodetic(session.fix_position_n + noise_n, origin)
    velocity_n = gnss.velocity_n + poor[:, None] * rng.normal(size=(len(gnss.t), 3)) * 1.5
    said = np.where(poor, 10.0, 1.0)
    gnss = replace(
        gnss,
        lat_deg=lat,
        lon_deg=lon,
        alt_m=alt,
        velocity_n=velocity_n,
        sigma_horizontal=0.3 * said,
        sigma_up=0.6 * said,
        sigma_velocity=0.15 * said,
    )
    return replace(session, gnss=gnss)


def _loose_plug(session: Session, seed: int) -> Session:
    """Three times no inertial samples for 3 s."""
    assert session.imu is not None
    t, rng = session.imu.t, np.random.default_rng(9500 + seed)
    starts = t[0] + (t[-1] - t[0]) * (np.array([0.25, 0.5, 0.75]) + rng.uniform(-0.1, 0.1, 3))
    kept = ~np.any([(t > start) & (t < start + 3.0) for start in starts], axis=0)
    force, rate = session.imu.specific_force_s[kept], session.imu.angular_rate_s[kept]
    return replace(session, imu=replace(session.imu, t=t[kept], specific_force_s=force, angular_rate_s=rate))


# The presets, and what some effects are for: ranges that are too small, a box that warms up, trees over the track, a
# plug that works loose
WORLDS = {
    "white": World("white"),
    "kart": World("kart"),
    "kart_harsh": World("kart_harsh"),
    "kart, 2 g and 150 deg/s": World("kart", {"imu_accel_range": 2.0 * 9.81, "imu_gyro_range": 150.0 * DEG}),
    "kart, box that warms up": World("kart", {"imu_accel_bias_walk": 0.03, "imu_gyro_bias_walk": 0.1 * DEG}),
    "kart, poor sky at times": World("kart", {}, _poor_sky),
    "kart, no samples at times": World("kart", {}, _loose_plug),
}


@dataclass(frozen=True)
class Simulated:
    """One simulated session of a world."""

    world: str
    case: Case


@dataclass(frozen=True)
class Thinned:
    """A recording with one fix in `interval` s, its first `duration` s."""

    recording: str
    interval: float
    duration: float

    @property
    def group(self) -> str:
        """Heading of its table's column."""
        return f"{self.recording}, one fix in {self.interval:g} s"


@dataclass(frozen=True)
class Twins:
    """Two modules in one car for half an hour: they are to say the same."""

    @property
    def group(self) -> str:
        """Heading of its table's column."""
        return "two modules in one car"


Work = Simulated | Thinned | Twins


@dataclass(frozen=True)
class Result:
    """One case with one effect off. errors: by quantity, or by block of a recording; scaled: rms error over sigma.

    Both are empty when the estimate had no solution.
    """

    group: str
    case: str
    effect: str
    errors: dict[str, float]
    scaled: dict[str, float]


def run(work: tuple[Work, str]) -> Result:
    """Estimate one case without one effect."""
    case, name = work
    try:
        effect = BY_NAME[name]
        if isinstance(case, Twins):
            return _run_twins(case, effect)
        return _run_recording(case, effect) if isinstance(case, Thinned) else _run_simulated(case, effect)
    except np.linalg.LinAlgError as error:  # what is left of the model may have no solution: that is a result as well
        print(f"{case}, {name}: {error}", file=sys.stderr)
        return Result(*_key(case, name), {}, {})


def _run_simulated(work: Simulated, effect: Effect) -> Result:
    case, befalls = work.case, WORLDS[work.world].befalls
    simulation = case.simulate()
    session = recorded(simulation)
    session = session if befalls is None else befalls(session, case.seed)
    estimate = effect.estimate(session)
    errors = rms_errors(simulation, compare(simulation, session, estimate, SCORED_RATE))
    normalised = normalised_errors(simulation, session, estimate, SCORED_RATE)
    scaled = {
        name: float(np.sqrt(np.nanmean(np.concatenate([normalised[part] for part in parts]) ** 2)))
        for name, parts in SIGMAS.items()
        if all(part in normalised for part in parts)
    }
    known = {name: errors[name] for name in HORIZONTAL if name in errors} | _constants_errors(simulation, estimate)
    return Result(work.world, case.name, effect.name, known, scaled)


def _constants_errors(simulation: Simulation, estimate: Trajectory) -> dict[str, float]:
    """Errors of the lever arm (horizontal, m) and of the latency of velocity (s), where they are identified."""
    found, truth = estimate.report.identified, simulation.scenario
    arm = np.asarray(found["lever_arm_b"].value, dtype=np.float64) - truth.lever_arm_b
    late = float(np.asarray(found["gps_velocity_latency"].value)) - truth.gnss.velocity_latency
    return {"arm": float(np.hypot(arm[0], arm[1])), "latency": abs(late)}


def _run_recording(case: Thinned, effect: Effect) -> Result:
    session = _beginning(prepare(load_raw(DATA / case.recording)), case.duration)
    thinned, kept = thin(session, case.interval)
    wanted = scored(session, kept)
    t, truth = session.gnss.t[wanted], session.fix_position_n[wanted, :2]
    position, with_offset, _ = read_estimate(effect.estimate(thinned), t)
    error = np.sum(((position if with_offset is None else with_offset) - truth) ** 2, axis=1)
    blocks = np.array_split(error, BLOCKS)
    errors = {f"block {i}": float(np.sqrt(np.mean(block))) for i, block in enumerate(blocks)}
    return Result(case.group, case.recording, effect.name, errors, {})


def _run_twins(case: Twins, effect: Effect) -> Result:
    sessions, t = twin_sessions(DATA)
    second, first = (effect.estimate(session) for session in reversed(sessions))
    lag = differ(effect.name, second, first, t).lag
    apart = np.sum((position_at(second, t + lag) - position_at(first, t))[:, :2] ** 2, axis=1)
    blocks = np.array_split(apart, BLOCKS)
    errors = {f"block {i}": float(np.sqrt(np.mean(block))) for i, block in enumerate(blocks)}
    return Result(case.group, case.group, effect.name, errors, {})


def _beginning(session: Session, duration: float) -> Session:
    """The first `duration` s of fixes, and the samples that belong to them."""
    assert session.imu is not None
    end = float(session.gnss.t[0]) + duration
    imu_part = session.imu.between(-np.inf, end + 1.0)
    return replace(session, gnss=session.gnss.select(session.gnss.t < end), imu=imu_part)


# ---- tables ---------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Change:
    """Mean and standard error of the logarithm of error without over error with an effect, of `count` pairs."""

    mean: float
    error: float
    count: int

    @staticmethod
    def of(off: Sequence[float], on: Sequence[float]) -> "Change":
        """Return the change of paired errors."""
        ratios = np.log(np.asarray(off) / np.asarray(on))
        spread = float(np.std(ratios, ddof=1)) if len(ratios) > 1 else np.nan
        return Change(float(np.mean(ratios)), spread / np.sqrt(len(ratios)), len(ratios))

    @property
    def costs(self) -> bool:
        """Whether being without costs more than chance."""
        return self.count > 2 and self.mean > max(student.ppf(1.0 - 1.0 / CHANCE, self.count - 1) * self.error, 0.002)

    @property
    def leans(self) -> bool:
        """Whether being without seems to cost something, though not more than chance may do."""
        return self.count > 2 and self.mean > max(2.0 * self.error, WORTH_A_WORD)

    @property
    def gains(self) -> bool:
        """Whether being without is better than chance."""
        return Change(-self.mean, self.error, self.count).costs

    def __str__(self) -> str:
        text = f"{_percent(self.mean)} ± {100.0 * self.error:.1f}"
        return f"**{text}**" if self.costs else f"*{text}*" if self.gains else text


def _percent(logarithm: float) -> str:
    value = 100.0 * (np.exp(logarithm) - 1.0)
    return f"{value:+.1f}" if abs(value) < 100.0 else f"{value:+.0f}"


def report(results: Sequence[Result]) -> str:
    """Return all tables as Markdown, and which effects nothing shows to be worth having."""
    by_key = {(r.group, r.case, r.effect): r for r in results}
    groups = list(dict.fromkeys(r.group for r in results))
    simulated = [g for g in groups if any("velocity" in r.errors for r in results if r.group == g)]
    changes: dict[str, dict[str, Change]] = {}
    out = []
    for group in simulated:
        names = sorted({r.case for r in results if r.group == group and r.effect == FULL.name})
        out += [f"\n### {group}\n", *_simulated_table(group, names, by_key, changes)]
    if len(simulated) > 1:
        out += ["\n### All simulated sessions together\n", *_pooled_table(simulated, results, by_key, changes)]
    if rest := [g for g in groups if g not in simulated]:
        out += ["\n### Recordings\n", *_recordings_table(rest, by_key, changes)]
    out += ["\n### What is earned\n", *_verdicts(changes)]
    return "\n".join(out)


Key = tuple[str, str, str]
Changes = dict[str, dict[str, Change]]


def _simulated_table(group: str, names: Sequence[str], by_key: dict[Key, Result], changes: Changes) -> list[str]:
    full = [by_key[group, name, FULL.name] for name in names]
    cells = [f"{np.sqrt(np.mean([r.errors[q] ** 2 for r in full])):.3g}" for q in HORIZONTAL]
    lines = [
        f"| without | {' | '.join(HEADINGS)} | error over sigma: {', '.join(SIGMAS)} | sessions |",
        f"|---|{'---:|' * (len(HORIZONTAL) + 2)}",
        f"| everything on: rms, m/s, m, deg | {' | '.join(cells)} | {_scaled(full)} | {len(full)} |",
    ]
    for effect in EFFECTS:
        pairs = [(by_key.get((group, n, effect.name)), f) for n, f in zip(names, full, strict=True)]
        known = [(off, on) for off, on in pairs if off is not None and off.errors]
        if not known:
            continue
        row = []
        for q, heading in zip(HORIZONTAL, HEADINGS, strict=True):
            both = [(o.errors[q], f.errors[q]) for o, f in known if np.isfinite(o.errors[q] * f.errors[q])]
            if not both:
                row.append("no value")
                continue
            change = Change.of(*zip(*both, strict=True))
            changes.setdefault(effect.name, {})[f"{group}: {heading}"] = change
            row.append(str(change))
        lines.append(f"| {effect.name} | {' | '.join(row)} | {_scaled([o for o, _ in known])} | {len(known)} |")
    return lines


def _pooled_table(
    groups: Sequence[str], results: Sequence[Result], by_key: dict[Key, Result], changes: Changes
) -> list[str]:
    lines = [f"| without | {' | '.join(HEADINGS)} | sessions |", f"|---|{'---:|' * (len(HORIZONTAL) + 1)}"]
    for effect in EFFECTS:
        offs = [r for r in results if r.effect == effect.name and r.group in groups and r.errors]
        pairs = [(off, by_key[off.group, off.case, FULL.name]) for off in offs]
        row = []
        for q, heading in zip(HORIZONTAL, HEADINGS, strict=True):
            both = [(o.errors[q], f.errors[q]) for o, f in pairs if np.isfinite(o.errors[q] * f.errors[q])]
            if both:
                change = Change.of(*zip(*both, strict=True))
                changes.setdefault(effect.name, {})[f"all: {heading}"] = change
            row.append(str(change) if both else "no value")
        if pairs:
            lines.append(f"| {effect.name} | {' | '.join(row)} | {len(pairs)} |")
    return lines


def _scaled(results: Sequence[Result]) -> str:
    known = [q for q in SIGMAS if all(q in r.scaled for r in results)]
    return ", ".join(f"{np.sqrt(np.mean([r.scaled[q] ** 2 for r in results])):.2f}" for q in known)


def _recordings_table(groups: Sequence[str], by_key: dict[Key, Result], changes: Changes) -> list[str]:
    def result(group: str, effect: str) -> Result | None:
        return next((r for (g, _, e), r in by_key.items() if g == group and e == effect), None)

    full = {g: found for g in groups if (found := result(g, FULL.name)) is not None}
    cells = [f"{np.sqrt(np.mean(np.square(list(r.errors.values())))):.3f} m" for r in full.values()]
    lines = [f"| without | {' | '.join(full)} |", f"|---|{'---:|' * len(full)}"]
    lines.append(f"| everything on: rms at dropped fixes | {' | '.join(cells)} |")
    for effect in EFFECTS:
        row = []
        for group, on in full.items():
            off = result(group, effect.name)
            if off is None or not off.errors:
                row.append("" if off is None else "no solution")
                continue
            change = Change.of(list(off.errors.values()), list(on.errors.values()))
            changes.setdefault(effect.name, {})[group] = change
            row.append(str(change))
        if any(row):
            lines.append(f"| {effect.name} | {' | '.join(row)} |")
    return lines


def _verdicts(changes: Changes) -> list[str]:
    lines = []
    for effect, found in changes.items():
        costs = sorted((c.mean, where) for where, c in found.items() if c.costs)
        gains = sorted((c.mean, where) for where, c in found.items() if c.gains)
        leans = sorted((c.mean, where) for where, c in found.items() if c.leans and not c.costs)
        if costs:
            verdict = f"earned: without, {_percent(costs[-1][0])} % at {costs[-1][1]}; {len(costs)} cells"
        elif leans:
            verdict = f"likely, on too few cases to be sure: without, {_percent(leans[-1][0])} % at {leans[-1][1]}"
        else:
            verdict = "**not shown to be earned**"
        if gains:
            verdict += f"; better without at {', '.join(f'{where} ({_percent(mean)} %)' for mean, where in gains)}"
        lines.append(f"- {effect}: {verdict}")
    return lines


# ---- running --------------------------------------------------------------------------------------------------------


def main() -> None:
    """Parse the arguments, run what is missing, print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--results", type=Path, default=Path("ablations.jsonl"), help="file of lines, added to")
    parser.add_argument("--report", action="store_true", help="run nothing, print the tables of what is there")
    parser.add_argument("--world", action="append", choices=list(WORLDS), help="default: all")
    parser.add_argument("--effect", action="append", choices=[e.name for e in EFFECTS], help="default: all")
    parser.add_argument("--seeds", type=int, default=6)
    parser.add_argument("--first-seed", type=int, default=0)
    parser.add_argument("--duration", type=float, default=100.0, help="s, of simulated sessions and of recordings")
    parser.add_argument("--interval", action="append", type=float, help="s between fixes of recordings; 1, 2, 5")
    parser.add_argument("--no-recordings", action="store_true")
    parser.add_argument("--no-simulations", action="store_true")
    parser.add_argument("--jobs", type=int, default=2)
    arguments = parser.parse_args()
    done = _load(arguments.results)
    if not arguments.report:
        wanted = _missing(_wanted(arguments), done)
        with ProcessPoolExecutor(arguments.jobs) as pool, arguments.results.open("a", encoding="utf-8") as file:
            for result in pool.map(run, wanted) if arguments.jobs > 1 else map(run, wanted):
                done.append(result)
                file.write(json.dumps(asdict(result)) + "\n")
                file.flush()
                print(f"{result.case}: {result.effect}", file=sys.stderr)
    print(report(done))


def _wanted(arguments: argparse.Namespace) -> list[tuple[Work, str]]:
    seeds = range(arguments.first_seed, arguments.first_seed + arguments.seeds)
    sessions: list[Work] = []
    for name in [] if arguments.no_simulations else arguments.world or WORLDS:
        world = WORLDS[name]
        drawn = cases(world.preset, seeds, arguments.duration)
        sessions += [Simulated(name, replace(case, changes=world.changes)) for case in drawn]
    if DATA.is_dir() and not arguments.no_recordings:
        for interval in arguments.interval or (1.0, 2.0, 5.0):
            sessions += [Thinned(name, interval, arguments.duration) for name in RECORDINGS]
        sessions.append(Twins())
    effects = [FULL.name, *(arguments.effect or [e.name for e in EFFECTS])]
    return [(session, effect) for effect in effects for session in sessions]


def _missing(wanted: list[tuple[Work, str]], done: list[Result]) -> list[tuple[Work, str]]:
    known = {(r.group, r.case, r.effect) for r in done}
    return [work for work in wanted if _key(*work) not in known]


def _key(work: Work, effect: str) -> Key:
    if isinstance(work, Thinned):
        return work.group, work.recording, effect
    if isinstance(work, Twins):
        return work.group, work.group, effect
    return work.world, work.case.name, effect


def _load(path: Path) -> list[Result]:
    if not path.exists():
        return []
    return [Result(**json.loads(line)) for line in path.read_text(encoding="utf-8").splitlines()]


if __name__ == "__main__":
    main()
