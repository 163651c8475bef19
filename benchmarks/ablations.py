"""Each effect that the smoother models, switched off alone: what does it cost, beyond the spread of seeds?

    SMOOTH_DATA=folder python benchmarks/ablations.py --results ablations.jsonl

Every case (a simulated session, a recording with fixes left out, two modules in one car) is estimated with everything
on, and with each effect off; a difference is paired, case by case. For simulated sessions it is that of the error
against truth, for recordings that at the dropped fixes or between the two modules, in blocks of time in place of
seeds. A change stands in the table in per cent with a hundred times the standard error of its logarithm; it counts
(bold) when Student's t says that chance would show it once in CHANCE (ablation_tables.py). The switches are options
and settings where there are any, else patches made for the length of a run (ablation_effects.py): the product has no
knobs for what nobody should turn.

Results are kept in a file of lines, so that a stopped run goes on where it was; --report prints the tables again.
"""

import argparse
import json
import os
import sys
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict, dataclass, replace
from pathlib import Path

os.environ.setdefault("OMP_NUM_THREADS", "1")  # one process per core; before numpy is imported
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np

from ablation_effects import BY_NAME, EFFECTS, FULL, Effect
from ablation_tables import HORIZONTAL, SIGMAS, Key, Result, report
from ablation_worlds import WORLDS
from scoring import SCORED_RATE, Case, cases, compare, normalised_errors, recorded, rms_errors
from smoother.estimate.resample import position_at
from smoother.prepare import prepare
from smoother.samples import Session
from smoother.session.load import load_raw
from smoother.sim.simulation import Simulation
from smoother.trajectory import Trajectory
from thinning import DATA, read_estimate, scored, thin
from twins import differ, twin_sessions

BLOCKS = 8  # of a recording, in place of seeds
RECORDINGS = ("kart_adria_first_half", "kart_lignano_racebox")


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
