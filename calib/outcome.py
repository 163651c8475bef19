"""The outcome of a procedure: values with their sigmas, before and after, and its part of the Calibration."""

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from smoother.arrays import Array
from smoother.calibration import Calibration


@dataclass(frozen=True, eq=False)
class Value:
    """A value with one standard deviation (None: not a measured one), both in `unit`; arrays of the same shape.

    `note`: a restriction, such as not observable, held at the prior, assumed.
    """

    name: str
    value: Array | float
    sigma: Array | float | None
    unit: str = ""
    note: str = ""


@dataclass(frozen=True)
class Comparison:
    """One measure of the error, before and after the calibration, in `unit`."""

    name: str
    before: float
    after: float
    unit: str


@dataclass(frozen=True, eq=False)
class Outcome:
    """One procedure on one recording.

    `calibration` holds its values only; `notes` are tables of calibration.toml for information;
    `remarks` are sentences. `drawing` is the fit and the data that its figure shows, by name.
    """

    procedure: str
    recording: str
    values: tuple[Value, ...]
    comparisons: tuple[Comparison, ...] = ()
    remarks: tuple[str, ...] = ()
    calibration: Calibration = field(default_factory=Calibration)
    notes: Mapping[str, Mapping[str, object]] = field(default_factory=dict)
    drawing: Mapping[str, object] = field(default_factory=dict)


@dataclass(frozen=True)
class Refusal:
    """Why a procedure did not run on a recording, in one sentence."""

    procedure: str
    recording: str
    reason: str


def rms(values: Array) -> float:
    """Root mean square over all entries."""
    return float(np.sqrt(np.mean(np.square(values))))
