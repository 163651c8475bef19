"""The switches of benchmarks/ablations.py: every effect can still be left out, by names that are still there."""

import importlib
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

from smoother.samples import Session
from smoother.sim.simulation import simulate_preset
from smoother.trajectory import Trajectory

BENCHMARKS = Path(__file__).resolve().parents[2] / "benchmarks"
SEED, DURATION, LONGER = 9, 50.0, 100.0  # s; clocks and receivers show late what they are like
COMPARED = ("position_n", "velocity_n", "R_nb")
# what effects are for that leave a usual kart as it is
WORLD_OF = {
    "accelerometer delay": "kart, late force on the wheel",
    "two fixes to a keyframe beyond 10 Hz": "kart, quick receiver on a long arm",
    "GPS offset as the fixes show it beforehand": "white",
    "velocities that err for a while": "kart, quick receiver that errs for a while",
    "walks of the biases as the session shows": "kart, box that warms up",
    "reported accuracies": "kart, poor sky at times",
    "more noise where samples miss": "kart, no samples at times",
    "receivers that go straight on": "kart, receiver that goes straight on",
    "receivers that have not settled": "kart, receiver from cold",
    "velocities turned against positions": "kart, magnetic course",
    "arm that stays with the kart, box on the wheel": "kart, late force on the wheel",
    "shape of what the Doppler filters": "kart, Doppler that is a mean of five",
    "slopes of what the receiver shows": "kart, Doppler that is a mean of five",
    "noise that the receiver filtered": "kart, Doppler that is a mean of five",
    "drift of the clocks": "kart, samples stamped by counting",
    "clocks that show different times": "kart, clocks 7 s apart",
    "alignment by changes between rare fixes": "kart, one fix in five seconds",
    "wander of Doppler": "kart, fixes that hardly wander",
    "corrections that come and go": "kart, corrections that come and go",
    "course later than speed": "kart, course later than speed",
}


@pytest.fixture(scope="module")
def modules() -> Iterator[dict[str, ModuleType]]:
    """The benchmarks as modules; their own folder is on the path only as long."""
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(BENCHMARKS)
        yield {name: importlib.import_module(name) for name in ("ablation_effects", "ablation_worlds", "scoring")}


@pytest.mark.parametrize("world", sorted({*WORLD_OF.values(), "kart"}))
def test_every_effect_can_be_left_out(modules: dict[str, ModuleType], world: str) -> None:
    effects = modules["ablation_effects"]
    session = _session(modules, world)
    full = effects.FULL.estimate(session)
    in_world = [effect for effect in effects.EFFECTS if WORLD_OF.get(effect.name, "kart") == world]
    assert in_world
    assert not [effect.name for effect in in_world if not _differ(effect.estimate(session), full)]


def _differ(one: Trajectory, other: Trajectory) -> bool:
    return any(not np.array_equal(getattr(one, name), getattr(other, name)) for name in COMPARED)


def _session(modules: dict[str, ModuleType], name: str) -> Session:
    world = modules["ablation_worlds"].WORLDS[name]
    duration = LONGER if world.befalls or name != "kart" else DURATION
    simulation = simulate_preset(world.preset, seed=SEED, duration=duration, **world.changes)
    session: Session = modules["scoring"].recorded(simulation)
    return session if world.befalls is None else world.befalls(session, SEED)
