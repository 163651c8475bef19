"""Laps on stdout: the table of laps and the figures below it, from the documents that summary.json holds."""

from __future__ import annotations

import math
import statistics
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from smoother.cli.output import number, print_line, print_pairs, print_table
from smoother.laps.clock import chance_text, lap_clock, local_time, local_zone, spread_text
from smoother.units import KMH, MPH
from smoother.words import SLOWER_WHERE, counted, loss_digits

if TYPE_CHECKING:
    from smoother.utc_clock import UtcClock

SPEED_UNITS: Mapping[str, float] = {"km/h": KMH, "mph": MPH}
SIGMA_SOURCES = {
    "joint": "",
    "stored": "the line was given after smoothing: each ± is typical of its session, not of the single lap",
    "model": "± assumes the usual slow error of a GPS, because this session does not show its own",
    "none": "",
}


def show_laps(
    laps: list[dict[str, Any]],
    analysis: dict[str, Any],
    clock: UtcClock | None,
    units: str = "km/h",
    title: str = "laps",
) -> None:
    """Print a row for every lap, and best, theoretical and rolling best, consistency, official times."""
    if laps:
        if clock is not None:
            title += f", times of day in {local_zone(clock.at(lap['start_s']) for lap in laps)}"
        print_table(title, *lap_table(laps, analysis, clock, units), left=-1)
    odd = [("laps" if i == 0 else "", f"{p['text']} [{p['code']}]") for i, p in enumerate(analysis["problems"])]
    if pairs := [*figures(analysis), *_sectors(laps), *odd]:
        print_pairs("", pairs)


def lap_table(
    laps: list[dict[str, Any]], analysis: dict[str, Any], clock: UtcClock | None, units: str
) -> tuple[list[str], list[list[str]]]:
    """Return the header and the rows of the table of laps."""
    sectors = sum(1 for name in laps[0] if name.startswith("sector") and name.endswith("_s") and "sigma" not in name)
    official = {one["lap"]: one for one in analysis["official"] if one["lap"] is not None}
    header = ["lap", "started", "time", "±", "gap", *(f"S{i + 1}" for i in range(sectors)), f"top {units}"]
    if clock is None:
        header.remove("started")
    header += ["official", "ours -"] if official else []
    best = (analysis["statistics"] or {}).get("best_s")
    rows = []
    for lap in laps:
        is_best = lap["lap"] == (analysis["statistics"] or {}).get("best_lap")  # without a gap to itself
        gap = None if best is None or is_best or not lap["valid"] else lap["lap_time_s"] - best
        row = [
            str(lap["lap"]),
            *([] if clock is None else [local_time(clock.at(lap["start_s"]))]),
            lap_clock(lap["lap_time_s"]),
            number(lap["lap_time_sigma_s"], 3),
            "-" if gap is None else f"{round(gap, 3) + 0.0:+.3f}",
            *(lap_clock(lap[f"sector{i + 1}_s"]) for i in range(sectors)),
            number(None if lap["top_speed_mps"] is None else lap["top_speed_mps"] / SPEED_UNITS[units], 1),
        ]
        if official:
            theirs = official.get(lap["lap"])
            row += (
                ["-", "-"]
                if theirs is None
                else [lap_clock(theirs["official_s"]), f"{round(theirs['difference_s'], 3) + 0.0:+.3f}"]
            )
        rows.append([*row, lap["reason"]])
    return [*header, ""], rows


def figures(analysis: dict[str, Any]) -> list[tuple[str, str]]:
    """Return names and values of the figures below the table."""
    line, summary = analysis["start_line"], analysis["statistics"]
    pairs = []
    if line is not None:
        named = f"of {analysis['track']}" if analysis["track"] else "given"
        where = {"found": "found where timing is most accurate", "file": "as the recording has it"}.get(
            line["source"], named
        )
        pairs.append(("line", f"{where}, lap {analysis['length_m']:.0f} m"))
    if summary is not None and summary["counted"]:
        pairs += [
            (
                "best",
                f"{lap_clock(summary['best_s'])} ± {number(summary['best_sigma_s'], 3)} (lap {summary['best_lap']})",
            ),
            *([("theoretical", theoretical)] if (theoretical := _theoretical(summary)) else []),
            *(
                [("rolling best", _rolling(summary))] if _is_known(summary["rolling_s"]) else []
            ),  # point-to-point runs have none
            ("consistency", _consistency(summary)),
        ]
    if lost := analysis.get("largest_losses"):
        pairs.append(("most lost", _most_lost(lost[0])))
    if slide := _slide(analysis):
        pairs.append(("sideslip", slide))
    if source := SIGMA_SOURCES.get(analysis["sigma_source"], ""):
        pairs.append(("error bars", source))
    return pairs


def _sectors(laps: list[dict[str, Any]]) -> list[tuple[str, str]]:
    """Median sigma of the difference of each sector from that of the best lap."""
    known: list[list[float]] = []
    while laps and f"sector{len(known) + 1}_gap_sigma_s" in laps[0]:
        sigmas = [lap[f"sector{len(known) + 1}_gap_sigma_s"] for lap in laps if lap["valid"]]
        known.append([sigma for sigma in sigmas if sigma])  # that of the best lap is zero
    if len(known) < 2 or not all(known):
        return []
    typical = (f"S{i + 1} ± {number(statistics.median(sigmas), 3)}" for i, sigmas in enumerate(known))
    return [("sectors", f"{', '.join(typical)} s (typical, against the same sector of the best lap)")]


def _slide(analysis: dict[str, Any]) -> str:
    """Largest sideslip of the best lap in a corner, or why it is not known."""
    if analysis.get("no_sideslip"):
        return f"not observable: {analysis['no_sideslip']}"
    best = (analysis["statistics"] or {}).get("best_lap")
    cells = [(c["number"], one) for c in analysis["corners"] for one in c["laps"] if one["lap"] == best]
    known = [(n, one) for n, one in cells if one.get("slide_deg") is not None and math.isfinite(one["slide_deg"])]
    if not known:
        return ""
    n, most = max(known, key=lambda pair: pair[1]["slide_deg"])
    angle = f"{most['slide_deg']:.1f} ± {most['slide_sigma_deg']:.1f} deg"
    return f"most in corner {n}: {angle}, pointing inwards (lap {best})"


def _most_lost(loss: dict[str, Any]) -> str:
    digits = loss_digits(loss["lost_sigma_s"])
    lost = f"{loss['lost_s']:.{digits}f} ± {loss['lost_sigma_s']:.{digits}f} s"
    return f"{lost} in corner {loss['corner']} {loss['direction']} on lap {loss['lap']}"


def _differences(loss: dict[str, Any], units: str) -> str:
    """The differences from the reference lap where time was lost."""
    braked: list[str] = []
    slower: list[str] = []
    factor = SPEED_UNITS[units]
    if (by := loss.get("braking_earlier_m")) is not None:
        braked = [f"braked {by:.0f} ± {loss['braking_earlier_sigma_m']:.0f} m earlier"]
    for name, where in SLOWER_WHERE.items():
        if (by := loss.get(f"{name}_slower_mps")) is not None:
            sigma = loss[f"{name}_slower_sigma_mps"]
            slower.append(f"{by / factor:.1f} ± {sigma / factor:.1f}{'' if slower else f' {units}'} {where}")
    return ", ".join([*braked, *([f"slower by {', '.join(slower)}"] if slower else [])])


def _theoretical(summary: dict[str, Any]) -> str:
    if not _is_known(summary["theoretical_s"]):
        return ""
    text = f"{lap_clock(summary['theoretical_s'])} ± {number(summary['theoretical_sigma_s'], 3)}"
    if summary["theoretical_s"] - summary["theoretical_raw_s"] > 0.0005:
        return f"{text} ({chance_text(summary['theoretical_s'], summary['theoretical_raw_s'], summary['best_s'])})"
    return (
        f"{text} (the best lap has all the best sectors)"
        if summary["theoretical_s"] > summary["best_s"] - 0.0005
        else text
    )


def _rolling(summary: dict[str, Any]) -> str:
    text = f"{lap_clock(summary['rolling_s'])} ± {number(summary['rolling_sigma_s'], 3)}"
    start, best = summary["rolling_from_m"], summary["theoretical_s"]
    about = [f"from {start:.0f} m"] if _is_known(start) and start != 0.0 else []
    if summary["rolling_s"] - summary["rolling_raw_s"] > 0.0005:
        about.append(f"timed as {lap_clock(summary['rolling_raw_s'])}, not corrected for chance")
    if summary["rolling_s"] < (best if _is_known(best) else summary["best_s"]) - 0.0005:
        about.append("may include parts of laps that do not count")
    return f"{text} ({'; '.join(about)})" if about else text


def _is_known(value: float | None) -> bool:
    return value is not None and math.isfinite(value)


def _consistency(summary: dict[str, Any]) -> str:
    count = summary["counted"]
    if count == 1:
        return "1 lap counts; there is no other to compare it with"
    text = (
        f"{counted(count, 'lap')} count, {summary['within_tenth'] - 1 or 'none'} of the others within 0.1 s of the best"
    )
    spread = spread_text(summary["spread_s"], "")
    return f"{text}, spread {spread}" if spread else text


def show_corners(laps: list[dict[str, Any]], analysis: dict[str, Any], units: str) -> None:
    """Print the time that every lap lost in each corner to the reference lap, and the median; `*`: real."""
    corners = analysis["corners"]
    if not corners:
        return
    header = ["lap", *(f"{c['number']}{c['direction'][0].upper()}" for c in corners), ""]
    rows = []
    for lap in laps:
        cells = [next((one for one in c["laps"] if one["lap"] == lap["lap"]), None) for c in corners]
        if all(cell is None for cell in cells):
            continue
        is_itself = lap["lap"] == analysis["reference_lap"]
        rows.append([str(lap["lap"]), *("- " if is_itself else _lost_in(cell) for cell in cells), lap["reason"]])
    usual = [_lost(c.get("usual_lost_s"), c.get("usual_is_real", False)) for c in corners]
    if any(cell != "-" for cell in usual):
        rows.append(["usual", *usual, "median of the other laps that count"])
    factor = SPEED_UNITS[units]
    print_line("")
    print_table(
        f"lost in each corner against {_against(analysis)}, s (* real, else may be chance)", header, rows, left=-1
    )
    slowest = [["-" if (v := _slowest(c, analysis)) is None else number(v / factor, 1) for c in corners]]
    print_table(f"slowest in the corner on the best lap, {units}", [*header[1:-1], ""], [[*slowest[0], ""]], left=-1)


def show_losses(analysis: dict[str, Any], units: str) -> None:
    """Print the largest real losses, or the likeliest where none is real, one a line, with the differences."""
    lost, likely = (analysis.get(name) or [] for name in ("largest_losses", "likely_losses"))
    if not (lost or likely):
        return
    print_line("")
    print_line(f"where time was {'lost' if lost else 'likely lost (none is certain)'}, against {_against(analysis)}")
    lost = lost or likely
    for loss in lost:
        what = _differences(loss, units)
        print_line(f"  {_most_lost(loss)}{': ' if what else ''}{what}")


def _against(analysis: dict[str, Any]) -> str:
    return analysis["reference_name"] or f"lap {analysis['reference_lap']}"


def _lost_in(cell: dict[str, Any] | None) -> str:
    return "-" if cell is None else _lost(cell["time_lost_s"], cell["is_real"])


def _lost(lost: float | None, is_real: bool) -> str:
    if lost is None or not math.isfinite(lost):
        return "-"
    return f"{round(lost, 2) + 0.0:+.2f}{'*' if is_real else ' '}"


def _slowest(corner: dict[str, Any], analysis: dict[str, Any]) -> float | None:
    best = (analysis["statistics"] or {}).get("best_lap")
    return next((one["min_speed_mps"] for one in corner["laps"] if one["lap"] == best), None)
