"""Are the sigmas honest? Shares of errors within one and two of them, and NEES, over many simulated sessions.

    python benchmarks/sigma_coverage.py --preset white --preset kart --seeds 40 --duration 600

Each seed is one session, on the three tracks in turn, standing and rolling starts in turn. Errors are correlated - in
position for minutes, in attitude by what the mounting is off for the whole session -, so that a share of many rows is
known from far fewer independent ones. Their number is estimated from the autocorrelation of being within the sigma and
from the scatter of the sessions, and printed; `may be` is where an honest share then lies, all shares of the table
together with 95 % (Bonferroni).

NEES is that of the keyframes nearest to fixed times, the mean over the sessions, which are independent, with chi-square
bounds for all times and parts together. It is 1 per degree of freedom when the covariance is honest.
"""

import argparse
import math
import os
import sys
import time
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, field, replace
from functools import partial

os.environ.setdefault("OMP_NUM_THREADS", "1")  # one process per core; before numpy is imported
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np
from scipy.special import erf
from scipy.stats import chi2, norm

from scoring import Case, NeesAt, cases, nees_at_times, normalised_errors, recorded
from smoother import api
from smoother.arrays import Array

RATE = 5.0  # Hz; errors change more slowly
WITHIN = (1.0, 2.0)  # sigmas
WANTED = {1.0: (0.63, 0.73), 2.0: (0.93, 0.97)}
FEWEST_SESSIONS = 8  # whose scatter says anything
CONFIDENCE = 0.95  # with which all shares of a table are inside their bounds together, when all are honest
PARTS = (("full", 9), ("attitude", 3), ("velocity", 3), ("position", 3))


@dataclass(frozen=True, eq=False)
class SessionErrors:
    """One session: errors over sigmas (N, c) by quantity, at RATE, NaN unknown; NEES at fixed times; CPU s taken."""

    case: Case
    normalised: dict[str, Array]
    nees: list[NeesAt]
    seconds: float


@dataclass(frozen=True)
class Share:
    """Share of errors within `sigmas` sigmas, of `count` rows worth `effective` independent ones."""

    quantity: str
    sigmas: float
    share: float
    count: int
    effective: float

    @property
    def honest(self) -> float:
        """Share of an honest sigma and normal errors."""
        return float(erf(self.sigmas / math.sqrt(2.0)))

    def bounds(self, together: int) -> tuple[float, float]:
        """Where an honest share lies when `together` of them are all to be inside with CONFIDENCE."""
        p = self.honest
        reach = float(norm.ppf(1.0 - 0.5 * (1.0 - CONFIDENCE) / together)) * math.sqrt(p * (1.0 - p) / self.effective)
        return max(p - reach, 0.0), min(p + reach, 1.0)

    def is_inside(self, together: int) -> bool:
        """Whether the share is what an honest sigma may give."""
        low, high = self.bounds(together)
        return low <= self.share <= high


@dataclass(frozen=True)
class MeanNees:
    """Mean over `sessions` of NEES per degree of freedom at one time s, of one part of the state."""

    part: str
    dimension: int
    t: float
    mean: float
    sessions: int

    def bounds(self, together: int) -> tuple[float, float]:
        """Where it lies when `together` of them are all to be inside with CONFIDENCE."""
        degrees, level = self.dimension * self.sessions, (1.0 - CONFIDENCE) / together
        low, high = chi2.ppf([0.5 * level, 1.0 - 0.5 * level], degrees) / degrees
        return float(low), float(high)

    def is_inside(self, together: int) -> bool:
        """Whether it is what an honest covariance may give."""
        low, high = self.bounds(together)
        return low <= self.mean <= high


@dataclass
class _Sums:
    """Autocovariance sums of many series: products and pairs at each lag."""

    products: Array = field(default_factory=lambda: np.zeros(0))
    pairs: Array = field(default_factory=lambda: np.zeros(0))

    def add(self, series: Array, known: Array) -> None:
        """Add one series (N,), zero where not known."""
        n = len(series)
        size = max(n, len(self.products))
        self.products, self.pairs = (np.pad(a, (0, size - len(a))) for a in (self.products, self.pairs))
        self.products[:n] += _correlated(series)
        self.pairs[:n] += _correlated(known)


def _correlated(series: Array) -> Array:
    """Sums (N,) of products of a series (N,) with itself, k rows later."""
    n = len(series)
    spectrum = np.fft.rfft(series, 2 * n)
    return np.asarray(np.fft.irfft(np.abs(spectrum) ** 2, 2 * n)[:n])


def effective_count(series: Sequence[Array]) -> float:
    """Number of independent rows that tell as much of the mean as all rows of series (N,) of separate sessions.

    NaN is unknown. Two estimates, of which the smaller counts: from the autocovariance about the mean of all, summed as
    long as sums of neighbouring pairs stay positive (Geyer 1992, initial positive sequence), which sees what lasts for
    seconds; and from the scatter of the sessions' own means, which sees what stays the same through a session, but is
    itself known to no better than one over the root of twice their number.
    """
    mean, sums = float(np.nanmean(np.concatenate(series))), _Sums()
    for values in series:
        known = np.isfinite(values)
        sums.add(np.where(known, values - mean, 0.0), known.astype(np.float64))
    total, variance = float(sums.pairs[0]), float(sums.products[0] / sums.pairs[0])
    if variance <= 1e-12:
        return float(len(series))  # all alike: nothing shows a row to be more than its session
    # products are not divided by their pairs: long lags, of which there are few, count for as little in the mean
    paired = sums.products[: len(sums.products) // 2 * 2].reshape(-1, 2).sum(axis=1)
    stop = np.flatnonzero(paired <= 0.0)
    positive = float((paired[: stop[0]] if stop.size else paired).sum())
    lasting = total / max(2.0 * positive / float(sums.products[0]) - 1.0, 1.0)
    means = np.array([np.nanmean(values) for values in series if np.any(np.isfinite(values))])
    if len(means) < FEWEST_SESSIONS:
        return lasting
    return min(lasting, len(means) * variance / max(float(np.var(means, ddof=1)), 1e-12))


def shares(sessions: Sequence[SessionErrors]) -> list[Share]:
    """Return the shares of every quantity within one and two sigmas."""
    out = []
    for name in sessions[0].normalised:
        columns = [column for s in sessions if name in s.normalised for column in s.normalised[name].T]
        for sigmas in WITHIN:
            inside = [np.where(np.isfinite(z), np.abs(z) <= sigmas, np.nan) for z in columns]
            rows = np.concatenate(inside)
            count = int(np.count_nonzero(np.isfinite(rows)))
            out.append(Share(name, sigmas, float(np.nanmean(rows)), count, effective_count(inside)))
    return out


def mean_nees(sessions: Sequence[SessionErrors]) -> list[MeanNees]:
    """Return the mean NEES of each part at each time that all sessions reach."""
    count = min(len(s.nees) for s in sessions)
    return [
        MeanNees(
            part,
            dimension,
            float(np.mean([s.nees[i].t for s in sessions])),
            float(np.mean([getattr(s.nees[i], part) for s in sessions])) / dimension,
            len(sessions),
        )
        for part, dimension in PARTS
        for i in range(count)
    ]


def run(case: Case, *, untold_delay: bool = False) -> SessionErrors:
    """Simulate, smooth, and compare with the truth. untold_delay: as if nobody said what the low-pass delays."""
    simulation = case.simulate()
    session = recorded(simulation)
    if untold_delay:
        session = replace(session, config=replace(session.config, imu_delay=None))
    since = time.process_time()
    estimate = api.smooth(session)
    seconds = time.process_time() - since
    return SessionErrors(
        case,
        normalised_errors(simulation, session, estimate, RATE),
        nees_at_times(simulation, session, estimate),
        seconds,
    )


def share_table(found: Sequence[Share]) -> str:
    """Return the shares as a Markdown table."""
    lines = [
        "| quantity | within 1 sigma, % | may be | wanted | within 2 sigma, % | may be | wanted | rows | worth |",
        "|---|---:|---|---|---:|---|---|---:|---:|",
    ]
    for one, two in zip(found[0::2], found[1::2], strict=True):
        cells = []
        for share in (one, two):
            low, high = share.bounds(len(found))
            wanted = WANTED[share.sigmas]
            mark = "" if share.is_inside(len(found)) else " **!**"
            reached = "yes" if wanted[0] <= share.share <= wanted[1] else "no"
            cells += [f"{100 * share.share:.1f}{mark}", f"{100 * low:.0f}-{100 * high:.0f}", reached]
        cells += [f"{one.count}", f"{min(one.effective, two.effective):.0f}"]
        lines.append(f"| {one.quantity.replace('_', ' ')} | {' | '.join(cells)} |")
    return "\n".join(lines)


def nees_table(found: Sequence[MeanNees]) -> str:
    """Return the NEES as a Markdown table: one row for each part, one column for each time."""
    times = [m.t for m in found if m.part == PARTS[0][0]]
    lines = [
        f"| NEES per degree of freedom | may be | outside | {' | '.join(f'{t:.0f} s' for t in times)} |",
        f"|---|---|---:|{'---:|' * len(times)}",
    ]
    for part, dimension in PARTS:
        row = [m for m in found if m.part == part]
        low, high = row[0].bounds(len(found))
        outside = sum(not m.is_inside(len(found)) for m in row)
        means = " | ".join(f"{m.mean:.2f}" for m in row)
        lines.append(f"| {part} ({dimension}) | {low:.2f}-{high:.2f} | {outside} of {len(row)} | {means} |")
    return "\n".join(lines)


def main() -> None:
    """Parse the arguments, run, print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--preset", action="append", choices=("white", "kart", "kart_harsh"), help="white and kart")
    parser.add_argument("--seeds", type=int, default=40)
    parser.add_argument("--first-seed", type=int, default=0)
    parser.add_argument("--duration", type=float, default=600.0, help="s")
    parser.add_argument(
        "--untold-delay",
        action="store_true",
        help="as if nobody said what the low-pass before the sampling delays, which is then unsure by 2 ms",
    )
    parser.add_argument("--jobs", type=int, default=2)
    arguments = parser.parse_args()
    one = partial(run, untold_delay=arguments.untold_delay)
    seeds = range(arguments.first_seed, arguments.first_seed + arguments.seeds)
    for preset in arguments.preset or ["white", "kart"]:
        wanted, found = cases(preset, seeds, arguments.duration), []
        with ProcessPoolExecutor(arguments.jobs) as pool:
            for session in pool.map(one, wanted) if arguments.jobs > 1 else map(one, wanted):
                found.append(session)
                print(f"{session.case.name}: {session.seconds:.1f} s", file=sys.stderr, flush=True)
        print(
            f"\n## {preset}: {len(found)} sessions of {arguments.duration:.0f} s, seeds {seeds.start}-{seeds.stop - 1}"
        )
        print(f"\n{share_table(shares(found))}\n")
        if means := mean_nees(found):
            print(nees_table(means), flush=True)


if __name__ == "__main__":
    main()
