"""Text and tables of report.html: summary, laps, corners, missing results, comparison with the baseline."""

from collections.abc import Iterator
from dataclasses import dataclass
from xml.etree.ElementTree import Element

import numpy as np

from smoother.arrays import Array
from smoother.estimate.judge.check import Check
from smoother.estimate.judge.quality import Quality
from smoother.estimate.preprocess.clock import utc_clock
from smoother.laps.clock import chance_text, local_day, local_time, local_zone, spread_text
from smoother.laps.lost import largest_losses
from smoother.laps.results import Lap, LapAnalysis, Statistics
from smoother.laps.top_speed import top_speed
from smoother.report.page_corners import place_of
from smoother.report.page_html import (
    DASH,
    Child,
    card,
    element,
    lap_clock,
    number,
    row,
    settings,
    speed_cell,
    speed_span,
    speed_unit,
    table,
    time_cell,
)
from smoother.report.summary import distance_driven
from smoother.samples import Session
from smoother.trajectory import Trajectory
from smoother.units import DEG, KMH
from smoother.utc_clock import UtcClock
from smoother.words import counted, duration, loss_digits, speed_digits

SIGMA_SOURCES = {
    "joint": "The ± of lap, sector and corner times allow for the GPS error that both of their ends share.",
    "stored": "The ± of times follow from the growth of the position error with time, as stored with the results.",
    "model": "The ± of times assume the usual slow error of a GPS, because this session does not show its own.",
    "none": "Times have no ±, because the estimate has no sigmas.",
}
OF_SECTORS = "The ± of a sector is that of its difference from the same sector of the best lap. "


@dataclass(frozen=True, eq=False)
class Report:
    """Data of the page. baseline, laps: None where there are none."""

    session: Session
    smoothed: Trajectory
    baseline: Trajectory | None
    laps: LapAnalysis | None
    quality: Quality


@dataclass(frozen=True, eq=False)
class PageContent(Report):
    """The same with the check of the recording as the sensors delivered it."""

    check: Check

    @property
    def statistics(self) -> Statistics | None:
        """Statistics of the laps that count, None where none does."""
        statistics = None if self.laps is None else self.laps.statistics
        return statistics if statistics is not None and statistics.counted else None

    @property
    def clock(self) -> UtcClock | None:
        """Clock of the times of day; None where the receiver gave no time."""
        return utc_clock(self.session, self.smoothed)

    @property
    def title(self) -> str:
        """Title of the session."""
        return self.session.config.title or self.session.name or "session"


def header(content: PageContent) -> Element:
    """Title, driver, kart, track, date and notes, and the settings of the page."""
    config, clock = content.session.config, content.clock
    track = content.laps.track if content.laps is not None and content.laps.track else config.track
    pairs = [("driver", config.driver), ("kart", config.kart), ("track", track)]
    parts = [f"{name}: {value}" for name, value in pairs if value]
    parts.append(local_day(clock.start_unix) if clock is not None else config.date or "")
    words = [element("h1", content.title), element("p", " · ".join(text for text in parts if text))]
    if config.notes:
        words.append(element("p", config.notes, class_="soft"))
    return element("header", element("div", *words), settings())


def summary(content: PageContent) -> Element:
    """Cards with the main results, and the missing results with their reasons."""
    statistics, smoothed = content.statistics, content.smoothed
    cards = []
    if statistics is not None and content.laps is not None and statistics.best_lap is not None:
        cards.append(
            card(
                "Best lap",
                lap_clock(statistics.best),
                _pm(statistics.best_sigma, content.laps.laps[statistics.best_lap]),
            )
        )
        if np.isfinite(statistics.theoretical):
            cards.append(card("Theoretical best", lap_clock(statistics.theoretical), _theoretical(statistics)))
        if np.isfinite(statistics.rolling):  # point-to-point runs have none
            cards.append(card("Rolling best", lap_clock(statistics.rolling), _rolling(statistics)))
        cards.append(
            card(
                "Consistency",
                spread_text(statistics.spread, counted(statistics.counted, "lap")),
                _consistency(statistics),
            )
        )
        if lost := largest_losses(content.laps, 1):
            at = element("a", place_of(lost[0], content.laps), href="#lost")
            digits = loss_digits(lost[0].sigma)
            below = element("span", f"± {number(lost[0].sigma, digits)} s, ", at)
            cards.append(card("Most lost in a corner", f"{number(lost[0].lost, digits)} s", below))
    fastest = top_speed(smoothed, content.laps)
    unit, sigma = speed_unit(), fastest.sigma
    below = (
        element("span", "± ", speed_span(sigma, speed_digits(sigma / KMH)), " ", unit) if np.isfinite(sigma) else unit
    )
    cards.append(card("Top speed", speed_span(fastest.speed), below))
    length = float(smoothed.t[-1] - smoothed.t[0])
    driven = f"{distance_driven(smoothed) / 1000.0:.2f} km"
    cards.append(card("Distance", driven, f"in {duration(length)}"))
    passed = content.quality.passed
    verdict = "Yes" if passed else "No"
    trust = element("span", verdict, class_="good" if passed else "bad")
    cards.append(card("Can I trust this?", trust, element("a", "see why", href="#quality")))
    missing = [element("li", text) for text in _missing(content)]
    note = [element("h3", "What is missing, and why"), element("ul", *missing)] if missing else []
    return element("section", element("dl", *cards, class_="cards"), *note, id="summary")


def _pm(sigma: float, lap: Lap) -> str:
    return f"± {number(sigma, 3)} s, lap {lap.number}" if np.isfinite(sigma) else f"lap {lap.number}"


def _theoretical(statistics: Statistics) -> str:
    text = (
        f"± {number(statistics.theoretical_sigma, 3)} s"
        if np.isfinite(statistics.theoretical_sigma)
        else "best sectors"
    )
    if statistics.theoretical - statistics.theoretical_raw > 0.0005:
        return f"{text}; {chance_text(statistics.theoretical, statistics.theoretical_raw, statistics.best)}"
    if statistics.theoretical > statistics.best - 0.0005:
        return f"{text}; the best lap has all the best sectors"
    return text


def _rolling(statistics: Statistics) -> str:
    text = f"± {number(statistics.rolling_sigma, 3)} s" if np.isfinite(statistics.rolling_sigma) else "one lap long"
    if statistics.rolling_from > 0.0:
        text += f", from {statistics.rolling_from:.0f} m"
    if statistics.rolling - statistics.rolling_raw > 0.0005:
        text += f"; timed as {lap_clock(statistics.rolling_raw)}, not corrected for chance"
    best = statistics.theoretical if np.isfinite(statistics.theoretical) else statistics.best
    return text if statistics.rolling > best - 0.0005 else f"{text}; it may include parts of laps that do not count"


def _consistency(statistics: Statistics) -> str:
    """Text below the spread of the laps, or below their number where there is no spread."""
    if statistics.counted == 1:
        return "that counts; there is no other to compare it with"
    which = (
        f"spread of {counted(statistics.counted, 'lap')} that count" if np.isfinite(statistics.spread) else "that count"
    )
    return f"{which}; {statistics.within_tenth - 1 or 'none'} of the others within 0.1 s of the best"


def _missing(content: PageContent) -> Iterator[str]:
    if content.smoothed.report.mode == "gps-only":
        yield (
            "Roll, pitch, yaw and sideslip: there is no usable motion sensor. Everything is from the GPS alone, "
            "accelerations from its smoothed speed."
        )
    if content.laps is None or not any(lap.is_timed for lap in content.laps.laps):
        why = "" if content.laps is None else "; ".join(p.text for p in content.laps.problems)
        yield f"Laps and every comparison of laps{': ' + why if why else '.'}"
    elif content.laps.no_sideslip and content.smoothed.report.mode != "gps-only":
        yield f"Sideslip: {content.laps.no_sideslip}."
    if content.smoothed.sigmas is None:
        yield "Uncertainties: the estimate has no sigmas."
    if content.baseline is None:
        yield "The comparison with the baseline: it was switched off, or the baseline has no estimate."


def lap_section(content: PageContent) -> list[Element]:
    """The table of laps and sectors with their sigmas, for sectors those of the difference from the best lap."""
    laps = content.laps
    if laps is None or not laps.laps:
        return []
    started, statistics = _starts(content), content.statistics
    official = {one.lap: one for one in laps.official if one.lap is not None}
    heads = ["lap", *([f"started ({local_zone(started)})"] if started else []), "time ± (s)", "gap"]
    heads += [*(f"S{i + 1} ±" for i in range(laps.sectors)), "top ", "raw GPS"]
    top: list[Child] = [element("span", "top ", speed_unit()) if h == "top " else h for h in heads]
    top += [*(["official", "ours −"] if official else []), "not counted"]
    rows = []
    for i, lap in enumerate(laps.laps):
        cells: list[Child] = [str(lap.number)]
        if started:
            cells.append(local_time(started[i]))
        is_best = statistics is not None and statistics.best_lap == i  # without a gap to itself
        gap = lap.time - statistics.best if statistics is not None and lap.is_valid and not is_best else np.nan
        cells += [time_cell(lap.time, lap.sigma), number(gap, 3, signed=True)]
        cells += [time_cell(*_sector(lap, k)) for k in range(laps.sectors)]
        cells += [speed_cell(lap.top_speed), lap_clock(lap.raw_time)]
        if official:
            theirs = official.get(i)
            cells += [DASH, DASH] if theirs is None else [lap_clock(theirs.time), number(theirs.difference, 3, True)]
        cells.append(", ".join(lap.reasons))
        rows.append(row(*cells, class_="best" if is_best else "" if lap.is_valid else "out"))
    source = laps.start_line.source if laps.start_line is not None else ""
    line = {
        "found": "The start/finish line was found where timing is most accurate. ",
        "file": "The start/finish line is the one in the recording. ",
    }.get(source, "")
    length = f"A lap is {laps.reference.length:.0f} m long. " if laps.reference is not None else ""
    of_sectors = "" if laps.sigma_source == "none" or laps.sectors < 2 else OF_SECTORS
    source_note = f"{SIGMA_SOURCES[laps.sigma_source]} {of_sectors}"
    note = f"{line}{length}± is one sigma. {source_note}Raw GPS: the lap time by straight lines between the fixes."
    made = [element("h2", "Laps", id="laps"), element("p", note, class_="soft"), table(top, rows)]
    return [*made, *(element("p", p.text) for p in laps.problems)]


def _starts(content: PageContent) -> list[float]:
    """UTC at the start of each lap, s since 1970; empty where the receiver gave no time."""
    if content.laps is None or content.clock is None:
        return []
    return [content.clock.at(lap.start) for lap in content.laps.laps]


def _sector(lap: Lap, k: int) -> tuple[float, float]:
    known = k < len(lap.sector_time)
    return (float(lap.sector_time[k]), _or_unknown(float(lap.sector_gap_sigma[k]))) if known else (np.nan, np.nan)


def _or_unknown(sigma: float) -> float:
    """The sigma of a difference, NaN for the best lap against itself."""
    return sigma if sigma > 0.0 else np.nan


def baseline_section(content: PageContent) -> list[Element]:
    """Differences of the baseline from the smoothed path, as numbers."""
    rows = [row(name, *values) for name, *values in _differences(content)]
    if not rows:
        return []
    return [table(["difference", "rms", "largest"], rows), *_yaw_note(content)]


def _yaw_note(content: PageContent) -> list[Element]:
    """Why the yaw of the baseline is wrong, where it is shown and has no magnetometer."""
    baseline = content.baseline
    if baseline is None or not np.isfinite(content.smoothed.R_nb).any():
        return []
    if not any(problem.code == "baseline_no_magnetometer" for problem in baseline.report.problems):
        return []
    text = (
        "Without a calibrated magnetometer the yaw of the baseline comes from the motion of the first minute and "
        "drifts after it. The baseline needs a calibrated logger (smooth calibrate); the smoother does not."
    )
    return [element("p", text, class_="soft")]


def _differences(content: PageContent) -> Iterator[tuple[Child, Child, Child]]:
    baseline, smoothed = content.baseline, content.smoothed
    if baseline is None:
        return
    at = np.stack([np.interp(baseline.t, smoothed.t, smoothed.position_n[:, k]) for k in (0, 1)], axis=1)
    away = np.hypot(*(baseline.position_n[:, :2] - at).T)
    yield _difference_row("position on the map (m)", away, 2)
    rms, largest = _rms_and_largest(baseline.speed - np.interp(baseline.t, smoothed.t, smoothed.speed))
    yield element("span", "speed (", speed_unit(), ")"), speed_span(rms, 2), speed_span(largest, 2)
    if np.isfinite(smoothed.R_nb).any():
        same = np.clip(np.searchsorted(smoothed.t, baseline.t), 0, len(smoothed) - 1)
        turn = baseline.euler - smoothed.euler[same]
        turn = (turn + np.pi) % (2.0 * np.pi) - np.pi
        for k, name in enumerate(("roll", "pitch", "yaw")):
            yield _difference_row(f"{name} (deg)", turn[:, k] / DEG, 1)


def _difference_row(name: str, values: Array, digits: int) -> tuple[str, str, str]:
    rms, largest = _rms_and_largest(values)
    return name, number(rms, digits), number(largest, digits)


def _rms_and_largest(values: Array) -> tuple[float, float]:
    """Rms and largest magnitude of the finite values (N,), NaN without any."""
    known = values[np.isfinite(values)]
    return (float(np.sqrt(np.mean(known**2))), float(np.abs(known).max())) if known.size else (np.nan, np.nan)
