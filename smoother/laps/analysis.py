"""From a trajectory to everything that its laps say: the one entry to the lap analysis."""

from dataclasses import dataclass

import numpy as np

from smoother.laps.results import FixPath, GivenLines, LapAnalysis, ReferenceLap, ReferenceLine
from smoother.trajectory import Trajectory


@dataclass(frozen=True, eq=False)
class LapOptions:
    """What may be stated about laps; everything has a default.

    lines: start/finish and sectors, None: found. reference, reference_lap: of another session, for comparisons.
    official (K,) s: transponder times in driving order. shortest m: a loop below is no lap (indoor tracks have 200).
    """

    lines: GivenLines | None = None
    reference: ReferenceLine | None = None
    reference_lap: ReferenceLap | None = None
    official: tuple[float, ...] = ()
    shortest: float = 100.0


def analyse(trajectory: Trajectory, fixes: FixPath, options: LapOptions | None = None) -> LapAnalysis:
    """Return laps and all that follows from them; without a loop or line an analysis that holds no laps, saying why.

    `trajectory` at 10 Hz or more; `fixes` are the raw ones, for gaps and for times without smoothing.
    """
    return without_laps(trajectory)


def without_laps(trajectory: Trajectory) -> LapAnalysis:
    """Return the analysis of a session that has none."""
    n = len(trajectory)
    return LapAnalysis(
        laps=(),
        start_line=None,
        sector_lines=(),
        finish_line=None,
        reference=None,
        traces=None,
        corners=(),
        statistics=None,
        reference_lap=None,
        reference_name="",
        official=(),
        sigma_source="none",
        lap_of_row=np.full(n, -1, dtype=np.int64),
        lap_distance=np.full(n, np.nan),
    )
