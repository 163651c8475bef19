"""Laps in files: the rows of laps.csv, the laps of summary.json, the columns of trajectory.csv."""

from typing import Any

import numpy as np
import polars as pl

from smoother.arrays import Array
from smoother.frames import Origin, nwu_to_geodetic
from smoother.laps.lost import Loss, largest_losses, likely_losses
from smoother.laps.results import Corner, Lap, LapAnalysis, Line, Statistics
from smoother.laps.sigma import Drift
from smoother.units import DEG

# times and sigmas have more digits than are shown, because rounding twice may change the last digit
TIME_DIGITS, DIGITS = 6, 3
Document = dict[str, Any]
LapColumns = tuple[pl.Series, Array]
"""Number of the lap, empty where none, and track distance m, NaN away from the track, of each row."""


def lap_rows(analysis: LapAnalysis) -> list[Document]:
    """Return a row for every lap, out- and in-laps too, under the names of laps.csv; NaN where unknown."""
    return [_row(lap, analysis.sectors) for lap in analysis.laps]


def _row(lap: Lap, sectors: int) -> Document:
    row: Document = {
        "lap": lap.number,
        "start_s": round(lap.start, TIME_DIGITS),
        "end_s": round(lap.end, TIME_DIGITS),
        "lap_time_s": round(lap.time, TIME_DIGITS),
        "lap_time_sigma_s": round(lap.sigma, TIME_DIGITS),
        "valid": lap.is_valid,
        "reason": ", ".join(lap.reasons),
    }
    for i in range(sectors):
        known = i < len(lap.sector_time)
        row[f"sector{i + 1}_s"] = round(float(lap.sector_time[i]), TIME_DIGITS) if known else np.nan
        row[f"sector{i + 1}_sigma_s"] = round(float(lap.sector_sigma[i]), TIME_DIGITS) if known else np.nan
    row["raw_time_s"] = round(lap.raw_time, TIME_DIGITS)
    row["distance_m"] = round(lap.distance, DIGITS)
    row["top_speed_mps"] = round(lap.top_speed, DIGITS)
    row["min_speed_mps"] = round(lap.min_speed, DIGITS)
    for i in range(sectors):
        known = i < len(lap.sector_gap_sigma)
        row[f"sector{i + 1}_gap_sigma_s"] = round(float(lap.sector_gap_sigma[i]), TIME_DIGITS) if known else np.nan
    return row


_COLUMNS: dict[str, Any] = {
    "lap": pl.Int64,
    "start_s": pl.Float64,
    "end_s": pl.Float64,
    "lap_time_s": pl.Float64,
    "lap_time_sigma_s": pl.Float64,
    "valid": pl.Boolean,
    "reason": pl.String,
}


def lap_table(analysis: LapAnalysis) -> pl.DataFrame:
    """Return laps.csv: its header alone without laps; unknown values are empty."""
    rows = lap_rows(analysis)
    if not rows:
        return pl.DataFrame(schema=_COLUMNS)
    schema = {name: _COLUMNS.get(name, pl.Float64) for name in rows[0]}
    return pl.DataFrame(rows, schema=schema).fill_nan(None)


def analysis_document(analysis: LapAnalysis, origin: Origin, drift: Drift | None = None) -> Document:
    """Return `lap_analysis` of summary.json: lines, statistics, corners, official times."""
    return {
        "track": analysis.track,
        "length_m": None if analysis.reference is None else analysis.reference.length,
        "start_line": _line(analysis.start_line, origin),
        "finish_line": _line(analysis.finish_line, origin),
        "sector_lines": [_line(line, origin) for line in analysis.sector_lines],
        "sigma_source": analysis.sigma_source,
        "position_drift": None
        if drift is None
        else {"lag_s": drift.lag, "change_m": drift.change, "absolute_m": drift.absolute},
        "reference_lap": None if analysis.reference_lap is None else analysis.laps[analysis.reference_lap].number,
        "reference_name": analysis.reference_name,
        "statistics": _statistics(analysis.statistics, analysis),
        "corners": [_corner(corner, analysis) for corner in analysis.corners],
        "largest_losses": [_loss(loss, analysis) for loss in largest_losses(analysis)],
        "likely_losses": [_loss(loss, analysis) for loss in likely_losses(analysis)],
        "no_sideslip": analysis.no_sideslip or None,
        "problems": [{"code": p.code, "text": p.text} for p in analysis.problems],
        "official": [
            {
                "number": time.number,
                "official_s": time.time,
                "lap": None if time.lap is None else analysis.laps[time.lap].number,
                "difference_s": time.difference,
                "sigma_s": time.sigma,
            }
            for time in analysis.official
        ],
    }


def _line(line: Line | None, origin: Origin) -> Document | None:
    if line is None:
        return None
    ends = np.concatenate([np.stack([line.left_n, line.right_n]), np.zeros((2, 1))], axis=1)
    lat, lon, _ = nwu_to_geodetic(ends, origin)
    return {
        "name": line.name,
        "source": line.source,
        "left": {"lat_deg": round(float(lat[0]), 9), "lon_deg": round(float(lon[0]), 9)},
        "right": {"lat_deg": round(float(lat[1]), 9), "lon_deg": round(float(lon[1]), 9)},
        "distance_m": line.distance,
    }


_TIMES = (
    *("best", "best_sigma", "theoretical", "theoretical_sigma", "theoretical_raw"),
    *("rolling", "rolling_sigma", "rolling_raw", "mean", "median", "spread"),
)


def _statistics(statistics: Statistics | None, analysis: LapAnalysis) -> Document | None:
    if statistics is None:
        return None
    best = statistics.best_lap
    return {
        "counted": statistics.counted,
        "best_lap": None if best is None else analysis.laps[best].number,
        **{f"{name}_s": getattr(statistics, name) for name in _TIMES},
        "rolling_from_m": statistics.rolling_from,
        "within_tenth": statistics.within_tenth,
    }


def _loss(loss: Loss, analysis: LapAnalysis) -> Document:
    """A loss; differences have keys of their own: `braking_earlier_m`, `minimum_slower_mps` and so on, each with ±."""
    row: Document = {
        "lap": analysis.laps[loss.lap].number,
        "corner": loss.corner.number,
        "direction": "left" if loss.corner.turns_left else "right",
        "lost_s": round(loss.lost, TIME_DIGITS),
        "lost_sigma_s": round(loss.sigma, TIME_DIGITS),
    }
    for each in loss.differences:
        name, unit = ("braking_earlier", "m") if each.kind == "braking" else (f"{each.kind}_slower", "mps")
        row |= {f"{name}_{unit}": round(each.by, DIGITS), f"{name}_sigma_{unit}": round(each.sigma, DIGITS)}
    return row


_SPEEDS = tuple((name, of) for name in ("entry", "min", "exit") for of in ("", "_sigma"))


def _corner(corner: Corner, analysis: LapAnalysis) -> Document:
    columns = {
        **{f"{name}_speed{of}_mps": getattr(corner, f"{name}_speed{of}") for name, of in _SPEEDS},
        "braking_point_m": corner.braking_point,
        "braking_sigma_m": corner.braking_sigma,
        "time_s": corner.time,
        "time_lost_s": corner.time_lost,
        "time_lost_sigma_s": corner.time_lost_sigma,
        "slide_deg": corner.slide / DEG,
        "slide_sigma_deg": corner.slide_sigma / DEG,
    }
    laps = []
    for i, lap in enumerate(analysis.laps):
        if not lap.is_timed:
            continue
        values = {name: round(float(column[i]), TIME_DIGITS) for name, column in columns.items()}
        laps.append({"lap": lap.number, **values, "is_real": bool(corner.is_real[i])})
    return {
        "number": corner.number,
        "start_m": corner.start,
        "apex_m": corner.apex,
        "end_m": corner.end,
        "direction": "left" if corner.turns_left else "right",
        "radius_m": corner.radius,
        "real_from_sigmas": round(corner.real_from, DIGITS),
        "usual_lost_s": round(corner.usual_lost, TIME_DIGITS),
        "usual_lost_sigma_s": round(corner.usual_lost_sigma, TIME_DIGITS),
        "usual_is_real": corner.usual_is_real,
        "laps": laps,
    }


def row_columns(analysis: LapAnalysis, analysed_t: Array, t: Array) -> LapColumns:
    """Return the columns `lap` (empty where none) and `lap_distance_m` (N,), NaN away from the track, at times t.

    analysed_t : times of the rows that were analysed, of which t may be others.
    """
    lap = np.full(len(t), -1, dtype=np.int64)
    for one in analysis.laps:
        end = np.inf if one.end >= analysed_t[-1] else one.end  # rows between the last one analysed and the end
        lap[np.searchsorted(t, one.start) : np.searchsorted(t, end, side="right")] = one.number
    column = pl.Series("lap", lap)
    column = column.set(column < 0, None)
    return column, _distance_at(analysis, analysed_t, t)


def _distance_at(analysis: LapAnalysis, analysed_t: Array, t: Array) -> Array:
    distance, reference = analysis.lap_distance, analysis.reference
    if len(t) == len(analysed_t) and np.array_equal(t, analysed_t):
        return distance
    known = np.isfinite(distance)
    if reference is None or not known.any():
        return np.full(len(t), np.nan)
    length = reference.length
    onward = np.unwrap(distance[known], period=length) if reference.is_closed else distance[known]
    there = np.interp(t, analysed_t, known.astype(np.float64)) > 0.99
    at = np.interp(t, analysed_t[known], onward)
    return np.where(there, np.mod(at, length) if reference.is_closed else at, np.nan)
