"""Two days in one file: the longer recording is used, and the other named.

A trajectory has rows for every moment from its first fix to its last: of a night between two drives they would fill a
gigabyte and say nothing.
"""

import numpy as np

from smoother.arrays import Array
from smoother.samples import Beside, GnssFixes, Problem, RawImu
from smoother.session.frozen import without_rows
from smoother.words import counted, span

LONGEST_PAUSE = 8.0 * 3600.0  # s without a sample and a fix within one recording; heats of one day are nearer


def longest_recording(
    gnss: GnssFixes, imu: RawImu | None, beside: Beside, file: str, problems: list[Problem]
) -> tuple[GnssFixes, RawImu | None, Beside]:
    """Return fixes, samples and what is beside them of the recording with most fixes; all where there is one only.

    Said in `problems` with how to have the others; `file` is the name for the sentences.
    """
    cuts = _cuts(gnss.t, None if imu is None else imu.t)
    if not cuts:
        return gnss, imu, beside
    bounds = np.array([-np.inf, *(0.5 * (first + last) for first, last in cuts), np.inf])
    most = int(np.argmax(np.histogram(gnss.t, bounds)[0]))
    begin, end = bounds[most], bounds[most + 1]
    used = (gnss.t > begin) & (gnss.t < end)
    lost, longest = int(np.count_nonzero(~used)), max(last - first for first, last in cuts)
    at = ", ".join(f"{first:.0f} s" for first, _ in cuts)
    text = (
        f"{file}: {len(cuts) + 1} recordings, with up to {span(longest)} between them; number {most + 1} is used, "
        f"{counted(lost, 'fix')} of the others left out. Split the files at {at} to have each"
    )
    problems.append(Problem("recordings_apart", text, lost))
    imu = None if imu is None else without_rows(imu, (imu.t < begin) | (imu.t > end))
    return gnss.select(used), imu, beside.between(begin, end)


def _cuts(fixes: Array, samples: Array | None) -> list[tuple[float, float]]:
    """From when to when, s, neither fixes (N,) s nor samples (M,) s were written for LONGEST_PAUSE."""
    cuts = []
    for i in np.flatnonzero(np.diff(fixes) > LONGEST_PAUSE).tolist():
        first, last = (0, 0) if samples is None else np.searchsorted(samples, fixes[[i, i + 1]])
        between = fixes[:0] if samples is None else samples[first:last]
        written = np.concatenate([fixes[[i]], between, fixes[[i + 1]]])
        hole = int(np.argmax(np.diff(written)))
        if written[hole + 1] - written[hole] > LONGEST_PAUSE:
            cuts.append((float(written[hole]), float(written[hole + 1])))
    return cuts
