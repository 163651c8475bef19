"""The section of report.html on trust: verdict, recording, residuals, identified constants."""

from collections.abc import Iterator, Mapping
from xml.etree.ElementTree import Element

import numpy as np

from smoother.arrays import Array
from smoother.laps.results import LapAnalysis
from smoother.laps.sigma import least_significant
from smoother.problems import remedy
from smoother.report.page_html import DASH, Child, element, number, row, speed_span, speed_unit, table
from smoother.report.page_sections import PageContent
from smoother.report.summary import is_reported, known_axes, mounting_angles, reported_problems, smoothing_time
from smoother.samples import Problem
from smoother.trajectory import WHITENED, Identified
from smoother.units import DEG
from smoother.words import measured, repeated


def trust(content: PageContent) -> list[Element]:
    """The verdict, its sentences, problems and findings."""
    quality = content.quality
    if quality.passed:
        verdict = element("p", element("strong", "Yes: it passed its own quality gate.", class_="good"))
    else:
        reasons = "; ".join(quality.reasons)
        verdict = element("p", element("strong", f"No: {reasons}.", class_="bad"))
    sentences = [element("li", text) for text in _trust_sentences(content)]
    findings = [f for f in content.check.findings if f.level != "ok"]
    warned = [element("li", f"{f.topic}: {f.text}") for f in findings]
    problems = [_problem(problem) for problem in reported_problems(content.session, content.smoothed.report)]
    made = [verdict, element("ul", *sentences)]
    if problems:
        made += [element("h3", "Problems of the recording"), element("ul", *problems)]
    if warned:
        made += [element("h3", "Check of the recording"), element("ul", *warned)]
    return made


def _problem(problem: Problem) -> Element:
    """A problem: its sentence, its code and its remedy."""
    advice = remedy(problem.code)
    todo = (element("br"), f"What to do: {advice}") if advice else ()
    return element("li", repeated(problem.text, problem.count), " ", element("code", problem.code), *todo)


def _trust_sentences(content: PageContent) -> Iterator[Child]:
    sigmas, statistics = content.smoothed.sigmas, content.statistics
    if sigmas is not None:
        across = float(np.nanmedian(np.hypot(sigmas.position_n[:, 0], sigmas.position_n[:, 1])))
        yield f"Absolute position: ± {number(across, 1)} m (one sigma), the slow error of the GPS included."
        track = sigmas.track[np.isfinite(sigmas.track)]
        if track.size:
            yield f"Line on the track, without that slow error: ± {number(float(np.median(track)), 2)} m."
        typical = speed_span(float(np.nanmedian(sigmas.speed)), 2)
        yield element("span", "Speed: ± ", typical, " ", speed_unit(), ".")
    if statistics is not None and np.isfinite(statistics.best_sigma):
        difference = _indistinguishable_difference(content.laps)
        enough = (
            f"; two laps that differ by less than {number(difference, 2)} s may be equally fast"
            if difference > 0.0
            else ""
        )
        yield f"Best lap: ± {number(statistics.best_sigma, 3)} s{enough}."
    measures = content.quality.measures
    if "far_fix_share" in measures:
        yield f"Fixes far from the path: {number(100.0 * measures['far_fix_share'], 1)} %."
    fixes = content.smoothed.report.fixes
    if fixes is not None and len(fixes.index):
        downweighted, used = int(np.sum(fixes.weight < 0.5)), len(fixes.index)
        unused = len(content.session.gnss) - used
        of_all = f"Fixes used: {used} of {len(content.session.gnss)}; removed: {unused}"
        yield f"{of_all}; used at less than half weight: {downweighted}."


def _indistinguishable_difference(laps: LapAnalysis | None) -> float:
    """Difference (s) of a lap from the best up to which both may be equally fast; 0 where none other counts."""
    if laps is None or laps.statistics is None or laps.statistics.best_lap is None:
        return 0.0
    best = laps.laps[laps.statistics.best_lap]
    others = [lap.sigma for lap in laps.laps if lap.is_valid and lap is not best and np.isfinite(lap.sigma)]
    return max(0.01, float(least_significant(np.hypot(best.sigma, np.median(others))))) if others else 0.0


_MEASURES: Mapping[str, tuple[str, str, int]] = {
    "fix_rate_hz": ("fixes a second", "", 1),
    "fix_gaps": ("gaps in the fixes", "", 0),
    "fix_gap_longest_s": ("longest gap in the fixes", "s", 2),
    "accuracy_median_m": ("accuracy the receiver reports", "m", 1),
    "satellites_median": ("satellites", "", 0),
    "imu_rate_hz": ("motion sensor samples a second", "", 1),
    "imu_gaps": ("gaps in the motion sensor", "", 0),
    "imu_gap_longest_s": ("longest gap in the motion sensor", "s", 3),
    "accel_vibration_mps2": ("vibration, acceleration rms", "m/s²", 1),
    "gyro_vibration_dps": ("vibration, turn rate rms", "deg/s", 0),
    "accel_clipped_share": ("clipped acceleration samples", "%", 2),
    "gyro_clipped_share": ("clipped turn rate samples", "%", 2),
    "mag_rate_hz": ("magnetometer samples a second", "", 1),
}


def recording_table(content: PageContent) -> Element:
    """Rates, gaps, vibration and clipping of the sensors."""
    rows = []
    for key, (name, unit, digits) in _MEASURES.items():
        value = content.check.measures.get(key, np.nan)
        is_of_none = key.endswith("_gap_longest_s") and value == 0.0
        if np.isfinite(value) and not is_of_none:
            rows.append(row(name, number(100.0 * value if unit == "%" else value, digits), unit))
    return table(["", "", ""], rows, "The recording", "words")


def residual_table(content: PageContent) -> Element:
    """The residuals of each kind of measurement."""
    rows = [
        row(
            _RESIDUALS.get(name, name.replace("_", " ").replace("gps", "GPS")),
            str(r.count),
            f"{number(r.rms, 3)} {r.unit}" if r.unit != WHITENED else "",
            number(r.normalised_rms, 2),
            str(r.rejected),
        )
        for name, r in content.smoothed.report.residuals.items()
    ]
    caption = (
        "Residuals. In sigma they should be about 1 or less, because the path is fitted to the measurements; far above "
        "1 the assumed noise is too small"
    )
    return table(["", "count", "rms", "in sigma", "little weight"], rows, caption, "tight")


_RESIDUALS = {
    "heading": "magnetometer",
    "slip": "wheels, sideways",
    "inertial": "motion sensor",
    "bias_walk": "bias drift of the motion sensor",
}
_NAMES = {
    "gps_position_latency": "GPS position latency",
    "gps_velocity_latency": "GPS speed latency",
    "gps_velocity_response": "time over which the receiver smooths its speed",
    "lever_arm_b": "antenna from the logger: forward, left, up",
    "R_bs": "mounting of the logger: roll, pitch, yaw",
    "slip_sigma": "variation of the slide between hard corners",
    "accel_noise": "accelerometer noise",
    "gyro_noise": "gyroscope noise",
    "accel_delay": "latency of the accelerometer behind the gyroscope",
    "mag_hard_iron": "hard iron at the magnetometer, on each axis",
    "mag_heading_offset": "heading offset of the magnetometer",
    "imu_clock_drift": "IMU clock against that of the fixes",
    "gps_position_noise": "GPS position noise: north, west, up",
    "gps_velocity_noise": "GPS velocity noise: north, west, up",
    "gps_offset_sigma": "GPS slow error: north, west, up",
    "gps_offset_tau": "GPS slow error, time constant",
    "gps_offset_change": "GPS slow error, change over one lap",
}


def identified_table(content: PageContent) -> Element:
    """The identified constants with their sigmas."""
    report = content.smoothed.report
    rows = [
        _identified(name, value) for name, value in report.identified.items() if is_reported(name, value, report.mode)
    ]
    return table(["", "value", "± one sigma", "unit", "from"], rows, "Identified constants", "words")


def _identified(name: str, found: Identified) -> Element:
    unit, factor, content = found.unit, 1.0, known_axes(name, found)
    if unit.startswith("rad"):
        unit, factor = unit.replace("rad", "deg", 1), 1.0 / DEG
    if name == "gps_velocity_response" and (time := smoothing_time(found)) is not None:
        unit, (values, errors) = "s", ([time[0]], [time[1]])
    elif name == "R_bs":
        unit, (values, errors) = "deg", mounting_angles(found)
    else:
        values, errors = (_flat(numbers, factor)[content] for numbers in (found.value, found.sigma))
    shown = measured(values, errors, _digits(np.array(values)))
    called = _NAMES.get(name, name.replace("_", " ").replace("gps", "GPS"))
    if content != slice(None):
        called = called.replace(", up", " (up is not known)")
    return row(called, shown[0], shown[1] or DASH, unit.replace("^2", "²").replace("sqrt(Hz)", "√Hz"), found.source)


def _flat(numbers: object, factor: float) -> list[float]:
    """One number or many, scaled; empty for None."""
    return [] if numbers is None else (np.ravel(np.asarray(numbers, dtype=np.float64)) * factor).tolist()


def _digits(values: Array) -> int:
    """Digits behind the point of values (N,) that have no sigma."""
    largest = float(np.max(np.abs(values[np.isfinite(values)]), initial=0.0))
    return 1 if largest >= 10.0 else 2 if largest >= 1.0 else 3 if largest >= 0.1 else 4
