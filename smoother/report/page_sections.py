"""What report.html says in words and tables: summary, laps, corners, what is missing, the older method beside it."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from xml.etree.ElementTree import Element

import numpy as np

from smoother.arrays import Array
from smoother.estimate.check import Check
from smoother.estimate.quality import Quality
from smoother.estimate.true_time import utc_clock
from smoother.laps.clock import local_day, local_time, local_zone, luck_said, spread_said
from smoother.laps.lost import Loss, largest_losses, likely_losses
from smoother.laps.results import Corner, Lap, LapAnalysis, Statistics
from smoother.laps.top_speed import top_speed
from smoother.report.page_charts import settings
from smoother.report.page_data import drawn_laps
from smoother.report.page_html import Child, element, row, table
from smoother.report.page_words import DASH, lap_clock, number, with_sigma
from smoother.report.summary import distance_driven
from smoother.samples import Session
from smoother.trajectory import Trajectory
from smoother.units import DEG, KMH
from smoother.utc_clock import UtcClock
from smoother.words import SLOWER_WHERE, counted, duration, loss_digits, speed_digits

SIGMA_SOURCES = {
    "joint": "The ± of lap, sector and corner times allow for the GPS error that both of their ends share.",
    "stored": "The ± of times follow from the growth of the position error with time, as stored with the results.",
    "model": "The ± of times assume the usual slow error of a GPS, because this session does not show its own.",
    "none": "Times have no ±, because the estimate has no sigmas.",
}
OF_SECTORS = "The ± of a sector is that of its difference from the same sector of the best lap. "


@dataclass(frozen=True, eq=False)
class Told:
    """What the words are about. check: of the recording, as the sensors delivered it."""

    session: Session
    smoothed: Trajectory
    baseline: Trajectory | None
    laps: LapAnalysis | None
    quality: Quality
    check: Check

    @property
    def statistics(self) -> Statistics | None:
        """Figures of the laps that count, None where none does."""
        said = None if self.laps is None else self.laps.statistics
        return said if said is not None and said.counted else None

    @property
    def clock(self) -> UtcClock | None:
        """Of the time of day; None where the receiver never told it."""
        return utc_clock(self.session, self.smoothed)

    @property
    def title(self) -> str:
        """What the session is called."""
        return self.session.config.title or self.session.name or "session"


def speed_cell(speed: float) -> Element:
    """A cell with a speed m/s, which the script shows in the unit that was chosen."""
    if not np.isfinite(speed):
        return element("td", DASH)
    return element("td", number(speed / KMH, 1), data_mps=f"{speed:.4f}")


def speed_span(speed: float, digits: int = 1) -> Element:
    """A speed m/s within a text, in the unit that was chosen, which :func:`speed_unit` tells."""
    more = {} if digits == 1 else {"data_digits": str(digits)}
    return element("span", number(speed / KMH, digits), data_mps=f"{speed:.5f}", **more)


def speed_unit() -> Element:
    """The unit of speed that was chosen."""
    return element("span", "km/h", class_="speed-unit")


def header(told: Told) -> Element:
    """Title, who and where, the verdict in a line, and the settings."""
    config, clock = told.session.config, told.clock
    track = told.laps.track if told.laps is not None and told.laps.track else config.track
    pairs = [("driver", config.driver), ("kart", config.kart), ("track", track)]
    said = [f"{name}: {value}" for name, value in pairs if value]
    said.append(local_day(clock.start_unix) if clock is not None else config.date or "")
    words = [element("h1", told.title), element("p", " · ".join(text for text in said if text))]
    if config.notes:
        words.append(element("p", config.notes, class_="soft"))
    return element("header", element("div", *words), settings())


def summary(told: Told) -> Element:
    """The figures a driver looks for first, and what is missing."""
    said, smoothed = told.statistics, told.smoothed
    cards = []
    if said is not None and told.laps is not None and said.best_lap is not None:
        cards.append(_card("Best lap", lap_clock(said.best), _pm(said.best_sigma, told.laps.laps[said.best_lap])))
        if np.isfinite(said.theoretical):
            cards.append(_card("Theoretical best", lap_clock(said.theoretical), _theoretical(said)))
        if np.isfinite(said.rolling):  # runs from A to B have none
            cards.append(_card("Rolling best", lap_clock(said.rolling), _rolling(said)))
        cards.append(_card("Consistency", spread_said(said.spread, counted(said.counted, "lap")), _consistency(said)))
        if lost := largest_losses(told.laps, 1):
            at = element("a", _where(lost[0], told.laps), href="#lost")
            digits = loss_digits(lost[0].sigma)
            below = element("span", f"± {number(lost[0].sigma, digits)} s, ", at)
            cards.append(_card("Most lost in a corner", f"{number(lost[0].lost, digits)} s", below))
    fastest = top_speed(smoothed, told.laps)
    unit, sure = speed_unit(), fastest.sigma
    below = element("span", "± ", speed_span(sure, speed_digits(sure / KMH)), " ", unit) if np.isfinite(sure) else unit
    cards.append(_card("Top speed", speed_span(fastest.speed), below))
    length = float(smoothed.t[-1] - smoothed.t[0])
    driven = f"{distance_driven(smoothed) / 1000.0:.2f} km"
    cards.append(_card("Distance", driven, f"in {duration(length)}"))
    passed = told.quality.passed
    verdict = "Yes" if passed else "No"
    trust = element("span", verdict, class_="good" if passed else "bad")
    cards.append(_card("Can I trust this?", trust, element("a", "see why", href="#quality")))
    missing = [element("li", text) for text in _missing(told)]
    note = [element("h3", "What is missing, and why"), element("ul", *missing)] if missing else []
    return element("section", element("dl", *cards, class_="cards"), *note, id="summary")


def _card(name: str, value: Child, below: Child) -> Element:
    return element("div", element("dt", name), element("dd", value, element("small", below)), class_="card")


def _pm(sigma: float, lap: Lap) -> str:
    return f"± {number(sigma, 3)} s, lap {lap.number}" if np.isfinite(sigma) else f"lap {lap.number}"


def _theoretical(said: Statistics) -> str:
    text = f"± {number(said.theoretical_sigma, 3)} s" if np.isfinite(said.theoretical_sigma) else "best sectors"
    if said.theoretical - said.theoretical_raw > 0.0005:
        return f"{text}; {luck_said(said.theoretical, said.theoretical_raw, said.best)}"
    if said.theoretical > said.best - 0.0005:
        return f"{text}; the best lap has all the best sectors"
    return text


def _rolling(said: Statistics) -> str:
    text = f"± {number(said.rolling_sigma, 3)} s" if np.isfinite(said.rolling_sigma) else "one lap long"
    if said.rolling_from > 0.0:
        text += f", from {said.rolling_from:.0f} m"
    if said.rolling - said.rolling_raw > 0.0005:
        text += f"; timed as {lap_clock(said.rolling_raw)}, not corrected for chance"
    best = said.theoretical if np.isfinite(said.theoretical) else said.best
    return text if said.rolling > best - 0.0005 else f"{text}; it may include parts of laps that do not count"


def _consistency(said: Statistics) -> str:
    """What stands below the spread of the laps, or their number where it has none."""
    if said.counted == 1:
        return "that counts; there is no other to compare it with"
    which = f"spread of {counted(said.counted, 'lap')} that count" if np.isfinite(said.spread) else "that count"
    return f"{which}; {said.within_tenth - 1 or 'none'} of the others within 0.1 s of the best"


def _missing(told: Told) -> Iterator[str]:
    if told.smoothed.report.mode == "gps-only":
        yield (
            "Roll, pitch, yaw and sideslip: there is no usable motion sensor. Everything is from the GPS alone, "
            "accelerations from its smoothed speed."
        )
    if told.laps is None or not any(lap.is_timed for lap in told.laps.laps):
        why = "" if told.laps is None else "; ".join(p.text for p in told.laps.problems)
        yield f"Laps and every comparison of laps{': ' + why if why else '.'}"
    elif told.laps.no_sideslip and told.smoothed.report.mode != "gps-only":
        yield f"Sideslip: {told.laps.no_sideslip}."
    if told.smoothed.sigmas is None:
        yield "Uncertainties: the estimate has no sigmas."
    if told.baseline is None:
        yield "The comparison with the baseline: it was switched off, or the baseline has no estimate."


def lap_section(told: Told) -> list[Element]:
    """The table of laps and sectors, these with their sigma against the best lap's; nothing without a lap."""
    laps = told.laps
    if laps is None or not laps.laps:
        return []
    started, said = _starts(told), told.statistics
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
        is_best = said is not None and said.best_lap == i  # of itself there is no gap
        gap = lap.time - said.best if said is not None and lap.is_valid and not is_best else np.nan
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


def _starts(told: Told) -> list[float]:
    """UTC at the start of each lap, s since 1970; none where the receiver never told it."""
    if told.laps is None or told.clock is None:
        return []
    return [told.clock.at(lap.start) for lap in told.laps.laps]


def _sector(lap: Lap, k: int) -> tuple[float, float]:
    known = k < len(lap.sector_time)
    return (float(lap.sector_time[k]), _or_unknown(float(lap.sector_gap_sigma[k]))) if known else (np.nan, np.nan)


def _or_unknown(sigma: float) -> float:
    """The sigma of a difference; of the best lap against itself there is none to show."""
    return sigma if sigma > 0.0 else np.nan


def time_cell(time: float, sigma: float) -> Element:
    """A cell with a time and its sigma, s."""
    if not np.isfinite(time):
        return element("td", DASH)
    return element("td", lap_clock(time), element("small", f" ± {number(sigma, 3)}" if np.isfinite(sigma) else ""))


def corner_section(told: Told) -> list[Element]:
    """What was lost where, real or within noise, and the corners of the best lap; nothing without corners."""
    laps = told.laps
    if laps is None or not laps.corners:
        return []
    against = laps.reference_name if laps.reference_lap is None else f"lap {laps.laps[laps.reference_lap].number}"
    lost: list[Element] = []
    if any(np.isfinite(c.time_lost[i]) for c in laps.corners for i in _compared(laps)):
        note = (
            f"Seconds lost to {against} between the fastest places before and after each corner. "
            f"{stars_note(laps.corners)}"
        )
        heads = ["lap", *(corner_name(c) for c in laps.corners)]
        lost = [element("p", note, class_="soft"), table(heads, _lost_rows(laps), class_="dense")]
    return [element("h2", "Corners", id="corners"), *_where_lost(laps, against), *lost, *_corner_speeds(laps)]


def _where_lost(laps: LapAnalysis, against: str) -> list[Element]:
    """The largest real losses, one a line; that there is none is said too."""
    if not any(lap.is_valid and i != laps.reference_lap for i, lap in enumerate(laps.laps)):
        return []
    lost, title = largest_losses(laps), element("h3", "Where time was lost", id="lost")
    if not any(np.isfinite(corner.time_lost_sigma).any() for corner in laps.corners):
        text = f"The uncertainty of the losses to {against} is unknown in this session, so none is called real."
        return [title, element("p", text)]
    if not lost:
        text = f"No loss to {against} in a single corner is larger than its uncertainty explains."
        likely = [_lost_item(loss, laps) for loss in likely_losses(laps)]
        if not likely:
            return [title, element("p", text)]
        unsure = element("p", f"{text} The likeliest, none of them certain:")
        return [title, unsure, element("ol", *likely, class_="soft")]
    note = f"The largest real losses to {against}, and what was clearly different there."
    items = (_lost_item(loss, laps) for loss in lost)
    return [title, element("p", note, class_="soft"), element("ol", *items)]


def _lost_item(loss: Loss, laps: LapAnalysis) -> Element:
    lost = with_sigma(loss.lost, loss.sigma, loss_digits(loss.sigma))
    item: list[Child] = [element("b", f"{lost} s"), f" {_where(loss, laps)}"]
    braked = [each for each in loss.differences if each.kind == "braking"]
    slower = [each for each in loss.differences if each.kind != "braking"]
    item += [f": braked {number(each.by, 0)} ± {number(each.sigma, 0)} m earlier" for each in braked]
    for k, each in enumerate(slower):
        by, sigma = speed_span(each.by), speed_span(each.sigma)
        unit: list[Child] = [" ", speed_unit()] if k == 0 else []
        before = (", slower by " if braked else ": slower by ") if k == 0 else ", "
        item += [before, by, " ± ", sigma, *unit, f" {SLOWER_WHERE[each.kind]}"]
    drawn = drawn_laps(laps)
    if laps.reference_lap in drawn and loss.lap in drawn:
        places = {name: f"{at:.1f}" for name, at in zip(("data_from", "data_to"), loss.corner.segment, strict=True)}
        both = f"{drawn.index(laps.reference_lap)} {drawn.index(loss.lap)}"
        item += [" ", element("button", "show", type="button", class_="look", data_laps=both, **places)]
    return element("li", *item)


def _where(loss: Loss, laps: LapAnalysis) -> str:
    return f"in corner {corner_name(loss.corner)} on lap {laps.laps[loss.lap].number}"


def stars_note(corners: Sequence[Corner]) -> str:
    """What a star beside a loss says, and how many times its sigma it takes."""
    times = number(corners[0].real_from, 1)
    return (
        f"Bold with a star: real, that is at least {times} times its ±, since some of so many losses are large by "
        "chance. The rest may be chance: ignore it."
    )


def _compared(laps: LapAnalysis) -> list[int]:
    """Indices of the laps shown that were timed, without the one that they are compared with."""
    return [i for i in drawn_laps(laps) if laps.laps[i].is_timed and i != laps.reference_lap]


def corner_name(corner: Corner) -> str:
    """Return what a corner is called."""
    return f"{corner.number} {'left' if corner.turns_left else 'right'}"


def _lost_rows(laps: LapAnalysis) -> list[Element]:
    rows = []
    for i in drawn_laps(laps):
        lap = laps.laps[i]
        if not lap.is_timed:
            continue
        name = str(lap.number) + ("" if lap.is_valid else f" ({', '.join(lap.reasons)})")
        is_itself = i == laps.reference_lap
        cells: list[Child] = [name, *(DASH if is_itself else lost_cell(corner, i) for corner in laps.corners)]
        rows.append(row(*cells, class_="" if lap.is_valid else "out"))
    return rows


def lost_cell(corner: Corner, i: int) -> Element:
    """A cell with what lap i lost in a corner, marked where it is real."""
    return _lost_cell(float(corner.time_lost[i]), float(corner.time_lost_sigma[i]), bool(corner.is_real[i]))


def usual_cell(corner: Corner, *after: Child) -> Element:
    """A cell with what is usually lost in a corner, marked where it is real."""
    return _lost_cell(corner.usual_lost, corner.usual_lost_sigma, corner.usual_is_real, *after)


def _lost_cell(lost: float, sigma: float, is_real: bool, *after: Child) -> Element:
    if not np.isfinite(lost):
        return element("td", DASH)
    star, kind = ("*", "slower" if lost > 0.0 else "faster") if is_real else ("", "noise")
    digits = loss_digits(sigma)
    small = element("small", f" ± {number(sigma, digits)}" if np.isfinite(sigma) and sigma > 0.0 else "")
    return element("td", f"{number(lost, digits, signed=True)}{star}", small, *after, class_=kind)


def _corner_speeds(laps: LapAnalysis) -> list[Element]:
    best = laps.statistics.best_lap if laps.statistics is not None else None
    shown = best if best is not None else laps.reference_lap
    if shown is None:
        return []
    timed = [i for i, lap in enumerate(laps.laps) if lap.is_valid and i != shown]
    heads: list[Child] = ["corner", "radius (m)", "braking point (m)"]
    heads += [element("span", f"{name} (", speed_unit(), ")") for name in ("entry", "slowest", "exit")]
    slides = any(np.isfinite(c.slide[shown]) for c in laps.corners)
    heads += [*(["slide (deg)"] if slides else []), *(["usual loss (s)", "real in"] if timed else [])]
    rows = []
    for c in laps.corners:
        real = f"{int(c.is_real[timed].sum())} of {len(timed)}"
        braking = with_sigma(float(c.braking_point[shown]), float(c.braking_sigma[shown]), 0)
        speeds = [speed_cell(float(speed[shown])) for speed in (c.entry_speed, c.min_speed, c.exit_speed)]
        cells: list[Child] = [corner_name(c), number(c.radius, 0), braking, *speeds]
        slide = with_sigma(float(c.slide[shown]) / DEG, float(c.slide_sigma[shown]) / DEG, 1, signed=True)
        cells += [slide] if slides else []
        cells += [usual_cell(c), real] if timed else []
        rows.append(row(*cells))
    title = f"Corners on lap {laps.laps[shown].number}"
    slide = (
        " Slide: angle by which the kart points further into the corner than it travels. The trace of sideslip shows "
        "it as + in a right corner and − in a left one."
        if slides
        else ""
    )
    usual_note = (
        " Usual loss: median of the other laps that count, with a star if real. Real in: number of laps with a real "
        "loss."
        if timed
        else ""
    )
    note = [f"Distances are metres from the line.{usual_note}", *_speeds_are_sure(laps, shown), slide]
    return [element("h3", title), element("p", *note, class_="soft"), table(heads, rows)]


def _speeds_are_sure(laps: LapAnalysis, shown: int) -> list[Child]:
    """How sure the speeds of a lap in corners are; where a kart brakes, a place that is unsure makes its speed so."""
    sigmas = [[c.entry_speed_sigma[shown], c.min_speed_sigma[shown], c.exit_speed_sigma[shown]] for c in laps.corners]
    known = np.array([row for row in sigmas if np.isfinite(row).all()])
    if not known.size:
        return []
    entry, least, leaving = (speed_span(float(one)) for one in np.median(known, axis=0))
    sure: list[Child] = [
        " Uncertainty of speeds: ± ",
        entry,
        " on entry, ± ",
        least,
        " at the slowest, ± ",
        leaving,
        " on exit (",
    ]
    return [*sure, speed_unit(), "), which contains the uncertainty of the position."]


def baseline_section(told: Told) -> list[Element]:
    """How far baseline and raw fixes lie from the smoothed path, in numbers; the charts stand below."""
    rows = [row(name, *values) for name, *values in _differences(told)]
    if not rows:
        return []
    return [table(["difference", "rms", "largest"], rows), *_lost_north(told)]


def _lost_north(told: Told) -> list[Element]:
    """Why the yaw of the baseline may be anywhere, where it is shown and has no compass to hold it."""
    baseline = told.baseline
    if baseline is None or not np.isfinite(told.smoothed.R_nb).any():
        return []
    if not any(problem.code == "baseline_no_magnetometer" for problem in baseline.report.problems):
        return []
    text = (
        "Without a calibrated magnetometer the yaw of the baseline comes from the motion of the first minute and "
        "drifts after it. The baseline needs a calibrated logger (smooth calibrate); the smoother does not."
    )
    return [element("p", text, class_="soft")]


def _differences(told: Told) -> Iterator[tuple[Child, Child, Child]]:
    baseline, smoothed = told.baseline, told.smoothed
    if baseline is None:
        return
    at = np.stack([np.interp(baseline.t, smoothed.t, smoothed.position_n[:, k]) for k in (0, 1)], axis=1)
    away = np.hypot(*(baseline.position_n[:, :2] - at).T)
    yield _told_of("position on the map (m)", away, 2)
    rms, largest = _rms_and_largest(baseline.speed - np.interp(baseline.t, smoothed.t, smoothed.speed))
    yield element("span", "speed (", speed_unit(), ")"), speed_span(rms, 2), speed_span(largest, 2)
    if np.isfinite(smoothed.R_nb).any():
        same = np.clip(np.searchsorted(smoothed.t, baseline.t), 0, len(smoothed) - 1)
        turn = baseline.euler - smoothed.euler[same]
        turn = (turn + np.pi) % (2.0 * np.pi) - np.pi
        for k, name in enumerate(("roll", "pitch", "yaw")):
            yield _told_of(f"{name} (deg)", turn[:, k] / DEG, 1)


def _told_of(name: str, values: Array, digits: int) -> tuple[str, str, str]:
    rms, largest = _rms_and_largest(values)
    return name, number(rms, digits), number(largest, digits)


def _rms_and_largest(values: Array) -> tuple[float, float]:
    """Of what is known of values (N,), NaN where nothing is."""
    known = values[np.isfinite(values)]
    return (float(np.sqrt(np.mean(known**2))), float(np.abs(known).max())) if known.size else (np.nan, np.nan)
