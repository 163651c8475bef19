"""Run every procedure that the recordings are sufficient for, each with the results of those before it."""

import datetime as dt
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from calib import allan, ellipsoid, gyro_bias, level, six_position, timing
from calib.outcome import Outcome, Refusal
from calib.recording import Recording
from smoother.calibration import Calibration, merged
from smoother.fit.ellipsoid import FitError
from smoother.frames import Origin


@dataclass(frozen=True)
class RunOptions:
    """first_samples: the thesis' gyro bias. place, date: for the magnetic model where the recording has neither."""

    first_samples: bool = False
    place: Origin | None = None
    date: dt.date | None = None


@dataclass(frozen=True, eq=False)
class Results:
    """One outcome per successful procedure (timing: one per recording), why others failed, and the calibration."""

    outcomes: tuple[Outcome, ...]
    refusals: tuple[Refusal, ...]
    calibration: Calibration
    notes: Mapping[str, Mapping[str, object]] = field(default_factory=dict)


Procedure = Callable[[Recording], Outcome]


def run(
    recordings: Sequence[Recording],
    options: RunOptions | None = None,
    progress: Callable[[str, float], None] = lambda stage, share: None,
) -> Results:
    """Calibrate from all recordings together. Of several outcomes of a procedure the most accurate counts."""
    options = RunOptions() if options is None else options
    state = _State([], [], Calibration())
    steps: list[tuple[str, Procedure]] = [
        (timing.PROCEDURE, timing.calibrate),
        (gyro_bias.PROCEDURE, lambda r: gyro_bias.calibrate(r, options.first_samples)),
        (six_position.PROCEDURE, six_position.calibrate),
        (six_position.TURNS_PROCEDURE, six_position.calibrate_gyro_scale),
        (allan.PROCEDURE, lambda r: allan.calibrate(r, state.calibration)),
        (ellipsoid.PROCEDURE, ellipsoid.calibrate),
        (timing.AGAINST_PROCEDURE, lambda r: timing.calibrate_against_gyro(r, state.calibration)),
        (
            level.PROCEDURE,
            lambda r: level.calibrate(r, state.calibration, state.has_common_axes, options.place, options.date),
        ),
    ]
    for i, (name, procedure) in enumerate(steps):
        progress(name, i / len(steps))
        state.take(name, recordings, procedure, keep_all=name == timing.PROCEDURE)
    notes: dict[str, dict[str, object]] = {}
    for outcome in state.outcomes:
        for table, keys in outcome.notes.items():
            notes.setdefault(table, {}).update(keys)
    return Results(tuple(state.outcomes), tuple(state.refusals), state.calibration, notes)


@dataclass
class _State:
    outcomes: list[Outcome]
    refusals: list[Refusal]
    calibration: Calibration

    @property
    def has_common_axes(self) -> bool:
        """Whether the magnetometer is aligned with the axes of the other sensors."""
        return any(outcome.procedure == timing.AGAINST_PROCEDURE for outcome in self.outcomes)

    def take(self, name: str, recordings: Sequence[Recording], procedure: Procedure, keep_all: bool) -> None:
        """Run a procedure on every recording and keep the best outcome, or else the reasons why there is none."""
        found: list[Outcome] = []
        refused: list[Refusal] = []
        for recording in recordings:
            try:
                found.append(procedure(recording))
            except FitError as error:
                refused.append(Refusal(name, recording.name, str(error)))
        if not found:
            self.refusals += refused
            return
        kept = found if keep_all else [min(found, key=_uncertainty)]
        for outcome in kept:
            self.outcomes.append(outcome)
            self.calibration = merged(self.calibration, outcome.calibration)


def _uncertainty(outcome: Outcome) -> tuple[int, float]:
    """Order of preference: the more values the better, then the smaller their relative sigmas."""
    sigmas = [np.max(np.abs(np.asarray(value.sigma))) for value in outcome.values if value.sigma is not None]
    return -len(outcome.values), float(sigmas[0]) if sigmas else np.inf
