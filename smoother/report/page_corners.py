"""The part of report.html about corners: where time was lost, and the corners of the best lap."""

from collections.abc import Sequence
from xml.etree.ElementTree import Element

import numpy as np

from smoother.laps.lost import Loss, largest_losses, likely_losses
from smoother.laps.results import Corner, LapAnalysis
from smoother.report.page_data import drawn_laps
from smoother.report.page_html import (
    DASH,
    Child,
    element,
    number,
    row,
    speed_cell,
    speed_span,
    speed_unit,
    table,
    with_sigma,
)
from smoother.units import DEG
from smoother.words import SLOWER_WHERE, loss_digits


def corner_section(laps: LapAnalysis | None) -> list[Element]:
    """Time lost in each corner, and the corners of the best lap; empty without corners."""
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
    """The largest real losses, one a line, or a sentence that there is none."""
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
    item: list[Child] = [element("b", f"{lost} s"), f" {place_of(loss, laps)}"]
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


def place_of(loss: Loss, laps: LapAnalysis) -> str:
    """Corner and lap of a loss, in words."""
    return f"in corner {corner_name(loss.corner)} on lap {laps.laps[loss.lap].number}"


def stars_note(corners: Sequence[Corner]) -> str:
    """The meaning of a star beside a loss, with the threshold in sigmas."""
    times = number(corners[0].real_from, 1)
    return (
        f"Bold with a star: real, that is at least {times} times its ±, since some of so many losses are large by "
        "chance. The rest may be chance: ignore it."
    )


def _compared(laps: LapAnalysis) -> list[int]:
    """Indices of the laps shown that were timed, without the one that they are compared with."""
    return [i for i in drawn_laps(laps) if laps.laps[i].is_timed and i != laps.reference_lap]


def corner_name(corner: Corner) -> str:
    """Return the name of a corner, as 4 left."""
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
    """A cell with the time that lap i lost in a corner, marked where it is real."""
    return _lost_cell(float(corner.time_lost[i]), float(corner.time_lost_sigma[i]), bool(corner.is_real[i]))


def usual_cell(corner: Corner, *after: Child) -> Element:
    """A cell with the usual loss in a corner, marked where it is real."""
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
    note = [f"Distances are metres from the line.{usual_note}", *_speed_sigma_note(laps, shown), slide]
    return [element("h3", title), element("p", *note, class_="soft"), table(heads, rows)]


def _speed_sigma_note(laps: LapAnalysis, shown: int) -> list[Child]:
    """Sigmas of the speeds of a lap in corners, which contain the position error times the slope of the speed."""
    sigmas = [[c.entry_speed_sigma[shown], c.min_speed_sigma[shown], c.exit_speed_sigma[shown]] for c in laps.corners]
    known = np.array([row for row in sigmas if np.isfinite(row).all()])
    if not known.size:
        return []
    entry, least, leaving = (speed_span(float(one)) for one in np.median(known, axis=0))
    note: list[Child] = [
        " Uncertainty of speeds: ± ",
        entry,
        " on entry, ± ",
        least,
        " at the slowest, ± ",
        leaving,
        " on exit (",
    ]
    return [*note, speed_unit(), "), which contains the uncertainty of the position."]
