"""From a directory, or one file of it, to a RawSession: find the files, read them, put them on one time base.

A format is one entry of `FORMATS`; the first that recognises what lies in the directory reads it. The module that
reads a format is imported when one is met, because a session has one of them.
"""

from __future__ import annotations

import itertools
import os
import shlex
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from smoother.arrays import Array, BoolArray
from smoother.config import SessionConfig
from smoother.disc import kept, release, settle
from smoother.errors import SessionError
from smoother.samples import (
    IMU_AFTER_FIXES,
    IMU_AXES_UNKNOWN,
    IMU_BEFORE_FIXES,
    IMU_INCOMPLETE,
    GnssFixes,
    Problem,
    RawImu,
    RawMag,
    RawSession,
)
from smoother.session.clock import describe_time_base, regularize, true_fix_times
from smoother.session.days import longest_recording
from smoother.session.files import IMU_NAMES, OWN_NAMES, RESULTS, Foreign, SessionFiles, is_packed, list_files, wanted
from smoother.session.frozen import without_frozen_sensor
from smoother.session.inertial import FEWEST_IMU_SAMPLES
from smoother.session.plausible import implausible_units, without_other_units
from smoother.session.refusals import NEVER_WRITTEN, holds_only_zeros, unrecognised
from smoother.session.settings import load_settings
from smoother.session.spikes import without_spikes
from smoother.session.standing import dead_problems, stuck_problems, without_frozen
from smoother.session.time_unit import LONGEST_PERIOD
from smoother.session.unknown_table import about_table
from smoother.session.week_rollover import with_present_dates
from smoother.words import counted, span

if TYPE_CHECKING:
    from smoother.session.foreign import ForeignReading
    from smoother.session.log import LogFiles

SLOWEST_IMU = 20.0  # Hz; below, a kart's motion between samples is lost (contract, section 3)
SAME_RATE = 0.02  # share; a clock or its digits may make 20 Hz a little less
SLOWEST_FIXES = 20.0  # s from one to the next; likewise
MANY_HEIGHTS = 50  # of which two would differ by a digit if they were measured
NO_RECEPTION = ("gps_no_fix", "gps_null_island")  # what a receiver writes that does not see its satellites
# said of files whose columns may be right all the same
OF_NO_COLUMN = ("gps_row_cut", "gps_time_unit", "gps_clock_set_back", "gps_blocks_moved", "gps_repeated_time")
FEWEST_FIXES_FOR_CLOCK = 32
SHORTEST_GPS_GAP = 1.0  # s; single lost fixes at 10 or 25 Hz are not worth a word
GAP_TIMES = 1.5  # usual steps
STEPS_BESIDE = 15  # on either side of one, which tell the rate there
SLOWEST_RATE = 1.0  # s from one fix to the next
MOST_FOLDERS = 1000  # looked through for a session; a home folder has many more
LEAST_UNFIXED = (10.0, 0.05)  # s and share of the IMU's recording, before the first fix or after the last


@dataclass(frozen=True, eq=False)
class Recording:
    """What one format made of a directory, before settings and time base. The file names are for sentences."""

    gnss: GnssFixes
    gnss_file: str
    inputs: tuple[str, ...]
    problems: tuple[Problem, ...]
    imu: RawImu | None = None
    imu_file: str = ""
    mag: RawMag | None = None
    mag_calibration_field: Array | None = None
    unix_at_zero: float | None = None  # where the file tells it, but not with each fix


@dataclass(frozen=True)
class Format:
    """One way a session may be recorded: whether it is there, how to read it, and which files it speaks of itself."""

    name: str
    recognises: Callable[[SessionFiles], bool]
    read: Callable[[SessionFiles], Recording]
    own: Callable[[SessionFiles], list[Path]]


def load_raw(path: Path) -> RawSession:
    """Read the session at `path`, a directory or one file of it.

    Flaws that could be lived with are in `problems`. Raises SessionError, one line with file and remedy, where
    nothing usable is left: no known file, no fix, files on clocks that do not overlap; ConfigError for settings.
    """
    files = list_files(path)
    if (form := _format_of(files)) is not None:
        recording = _read(files, form)
        problems = (*recording.problems, *_left_out(files, form, recording))
        return _finish(files, replace(recording, problems=problems))
    if (reason := unrecognised(files)) is not None:
        raise SessionError(f"{path}: no recording found; {reason}")
    if files.imu_table() is not None:
        raise SessionError(f"{path}: an IMU table, but neither gps.csv nor *.nmea; without fixes there is no track")
    if (log := files.unnamed_sentences()) is not None:
        raise SessionError(
            f"{path}: {log.name} holds NMEA sentences; name the file, smooth {shlex.quote(str(log))}, or call it *.nmea"
        )
    if packed := [name for name in files.names if is_packed(Path(name))]:
        raise SessionError(f"{path}: no recording found, but {packed[0]}, which is packed; unpack it first")
    if (below := _session_below(path)) is not None:
        raise SessionError(
            f"{path}: no recording found in it, but in folders of it ({below.relative_to(path)}); "
            f"for all of them: smooth batch {shlex.quote(str(path))}"
        )
    if (table := files.unknown_table()) is not None:
        raise SessionError(f"{path}: no recording found, but {table.name}; {about_table(table)}")
    raise SessionError(f"{path}: no recording found; wanted {wanted()}")


def _read(files: SessionFiles, form: Format) -> Recording:
    try:
        return form.read(files)
    except SessionError as error:
        named = files.directory / str(error).partition(":")[0]
        if named.is_file() and holds_only_zeros(named):
            raise SessionError(f"{named.name}: {NEVER_WRITTEN}") from error
        raise


def _session_below(path: Path) -> Path | None:
    """The first folder in a folder that holds a recording, if one is among the first that are looked at."""
    if not path.is_dir():
        return None
    for here, below, names in itertools.islice(os.walk(path), MOST_FOLDERS):
        below[:] = sorted(name for name in below if not name.startswith("."))
        if RESULTS.issubset(names):
            below.clear()
        elif Path(here) != path and _holds_recording(Path(here)):
            return Path(here)
    return None


def _holds_recording(folder: Path) -> bool:
    try:
        return bool(list_files(folder).recordings())
    except SessionError:  # it is closed to us
        return False


def _format_of(files: SessionFiles) -> Format | None:
    return next((form for form in FORMATS if form.recognises(files)), None)


def _left_out(files: SessionFiles, form: Format, recording: Recording) -> Iterator[Problem]:
    """What to say of recordings in a folder that are of another kind than the one that is read."""
    if files.chosen is not None:
        return
    own = {path.name for path in form.own(files)} | set(recording.inputs)
    if others := [path for path in files.recordings() if path.name not in own]:
        yield Problem("recordings_unused", _preferred(recording.gnss_file, others))


def _preferred(used: str, others: Sequence[Path]) -> str:
    """The sentence about recordings that are not used; their number stands in it, being the problem's count."""
    names = ", ".join(path.name for path in others)
    count = "" if len(others) == 1 else f"{len(others)} others: "
    return f"{used} is used, not {count}{names}; name a file to have that one"


def _finish(files: SessionFiles, recording: Recording) -> RawSession:
    """Apply session.toml and the clock; see to it that what is left can be used."""
    recording = replace(recording, gnss=_without_fillers(recording.gnss))
    settings = files.find("session.toml")
    config = SessionConfig() if settings is None else load_settings(settings)
    _require_fixes(recording)
    problems = [*recording.problems, *_missing_heights(recording)]
    dated = with_present_dates(recording.gnss, recording.gnss_file, time.time(), config.date, problems)
    recording = replace(recording, gnss=dated)
    imu = _usable_imu(recording, problems)
    gnss = _with_true_times(recording, problems)
    gnss, imu, mag = longest_recording(gnss, imu, _evened_mag(recording.mag), recording.gnss_file, problems)
    imu = _if_enough(imu, recording.imu_file, " in the recording that is used", problems)
    if imu is not None:
        imu = without_spikes(imu, recording.imu_file, problems)
        problems += dead_problems(imu, recording.imu_file)
        imu = without_frozen(imu, gnss, recording.imu_file, problems)
        imu = without_frozen_sensor(imu, gnss, recording.imu_file, problems)
        imu = _if_enough(imu, recording.imu_file, " in which neither sensor stands still", problems)
    if imu is not None:
        imu = without_other_units(imu, recording.imu_file, problems)
        problems += stuck_problems(imu, gnss, recording.imu_file)
        _compare_times(recording, imu, gnss, problems)
        settle(imu)
    return RawSession(
        name=files.session_name(),
        gnss=gnss,
        imu=imu,
        mag=None if mag is None or mag.t.size == 0 else mag,
        mag_calibration_field=recording.mag_calibration_field,
        config=config,
        inputs=recording.inputs if settings is None else (*recording.inputs, settings.name),
        problems=tuple(problems),
        unix_at_zero=recording.unix_at_zero if (told := gnss.unix_at_zero) is None else told,
    )


def _require_fixes(recording: Recording) -> None:
    if len(recording.gnss) == 0:
        against = [problem for problem in recording.problems if problem.code.startswith("gps_")]
        reasons = "; ".join(problem.text.partition(": ")[2] for problem in against)
        searched = all(problem.code in (*NO_RECEPTION, *OF_NO_COLUMN) for problem in against)
        remedy = "the antenna needs a free view of the sky before the start" if searched else "mend those columns"
        raise SessionError(f"{recording.gnss_file}: no usable fix{f' ({reasons})' if reasons else ''}; {remedy}")


def _without_fillers(gnss: GnssFixes) -> GnssFixes:
    """The fixes without heights, or speeds upwards, that are all 0: what a table has where nothing was measured.

    Taken for measured, they would be the surest of all. Of a height that never changes, only the first one counts.
    """
    velocity_n = gnss.velocity_n
    if np.nanmax(np.abs(velocity_n[:, 2]), initial=0.0) == 0.0:
        velocity_n = np.column_stack([velocity_n[:, :2], np.full(len(gnss), np.nan)])
    alt_m = gnss.alt_m if np.nanmax(np.abs(gnss.alt_m), initial=0.0) > 0.0 else np.full(len(gnss), np.nan)
    known = np.flatnonzero(np.isfinite(alt_m))
    if known.size >= MANY_HEIGHTS and np.all(alt_m[known] == alt_m[known[0]]):
        alt_m = np.where(np.arange(len(alt_m)) == known[0], alt_m, np.nan)
    return replace(gnss, velocity_n=velocity_n, alt_m=alt_m)


def _missing_heights(recording: Recording) -> Iterator[Problem]:
    if not np.any(np.isfinite(recording.gnss.alt_m)):
        text = (
            f"{recording.gnss_file}: no fix has a height; how high the track lies is unknown, and how steep a road is "
            "that climbs all the way. All else is as good"
        )
        yield Problem("gps_no_height", text)


def _usable_imu(recording: Recording, problems: list[Problem]) -> RawImu | None:
    """The inertial samples on an even time base; None, with the reason in `problems`, if they are of no use."""
    imu, file = recording.imu, recording.imu_file
    if imu is None:
        is_there = any(problem.code in (IMU_AXES_UNKNOWN, IMU_INCOMPLETE) for problem in problems)
        text = "no IMU that can be used" if is_there else "no IMU recorded"
        problems.append(Problem("imu_missing", f"{text}: smoothed from GPS alone"))
        return None
    base = regularize(imu.t)
    reasons = list(_reasons_against(imu, base.period))
    release(imu)
    for code, reason in reasons:
        problems.append(Problem(code, f"{file}: {reason}: smoothed from GPS alone"))
        return None
    problems += describe_time_base(base, "imu", file)
    imu = replace(imu, t=kept(base.t), longest_step=base.longest_step)
    release(imu)
    return imu


def _if_enough(imu: RawImu | None, file: str, which: str, problems: list[Problem]) -> RawImu | None:
    """The samples; None, said in `problems`, if hardly any are left; `which` completes what they are."""
    if imu is None or imu.t.size >= FEWEST_IMU_SAMPLES:
        return imu
    text = f"{file}: only {counted(imu.t.size, 'usable sample')}{which}: smoothed from GPS alone"
    problems.append(Problem("imu_missing", text))
    return None


def _reasons_against(imu: RawImu, period: float) -> Iterator[tuple[str, str]]:
    """Problem codes and reasons why the inertial samples cannot be used at all."""
    if imu.t.size < FEWEST_IMU_SAMPLES:
        yield "imu_missing", f"only {counted(imu.t.size, 'usable sample')}"
        return
    if period * SLOWEST_IMU > 1.0 + SAME_RATE:
        asked = "; is t_s in seconds?" if period > LONGEST_PERIOD else ""
        rates = f"{1 / period:.3g} samples a second, {SLOWEST_IMU:.0f} are needed"
        yield "imu_too_slow", f"the motion sensor is too slow ({rates}{asked})"
    for reason in implausible_units(imu):
        yield "imu_implausible", reason


def _evened_mag(mag: RawMag | None) -> RawMag | None:
    if mag is None or mag.t.size == 0:
        return None
    return replace(mag, t=regularize(mag.t).t)


def _with_true_times(recording: Recording, problems: list[Problem]) -> GnssFixes:
    """The fixes at the receiver's own times, by its UTC or else by its steady rate; a constant latency remains."""
    gnss = recording.gnss
    assert gnss.unix_s is not None
    t, by_utc = true_fix_times(gnss.t, gnss.unix_s)
    if not by_utc and len(gnss) >= FEWEST_FIXES_FOR_CLOCK:
        t = regularize(gnss.t).t
    steps = np.diff(t)
    if steps.size:
        if (usual := float(np.median(steps))) > SLOWEST_FIXES:
            text = f"{recording.gnss_file}: a fix only every {usual:.0f} s; is t_s in seconds?"
            problems.append(Problem("gps_too_slow", text))
        gaps = steps[_are_gaps(steps, usual)]
        if gaps.size:
            text = f"{recording.gnss_file}: {counted(gaps.size, 'gap')} in the fixes, the longest {span(gaps.max())}"
            problems.append(Problem("gps_gap", text, int(gaps.size)))
    return replace(gnss, t=t)


def _are_gaps(steps: Array, usual: float) -> BoolArray:
    """Mask (N,) of the steps from fix to fix, s, that are gaps beside those around them: receivers change their rate.

    usual s : of all of them. Fixes that come slower, and slower than SLOWEST_RATE, for a while are no other rate.
    """
    gaps = steps > SHORTEST_GPS_GAP
    long = np.flatnonzero(gaps)
    around = np.clip(long[:, None] + np.arange(-STEPS_BESIDE, STEPS_BESIDE + 1), 0, steps.size - 1)
    local = np.minimum(np.median(steps[around], axis=1), max(usual, SLOWEST_RATE))
    gaps[long] = steps[long] > GAP_TIMES * local
    return gaps


def _compare_times(recording: Recording, imu: RawImu, gnss: GnssFixes, problems: list[Problem]) -> None:
    """Raise SessionError if IMU and fixes never run together; say where one of them ran on without the other."""
    if gnss.t[-1] < imu.t[0] or imu.t[-1] < gnss.t[0]:
        raise SessionError(
            f"{recording.imu_file} ({imu.t[0]:.1f} to {imu.t[-1]:.1f} s) and {recording.gnss_file} "
            f"({gnss.t[0]:.1f} to {gnss.t[-1]:.1f} s) do not overlap in time; t_s must be one clock in both"
        )
    outside = int(np.count_nonzero((gnss.t < imu.t[0]) | (gnss.t > imu.t[-1])))
    if outside > 0.01 * len(gnss):
        text = f"{recording.gnss_file}: {outside} of {len(gnss)} fixes lie before or after the IMU's recording"
        problems.append(Problem("gps_outside_imu", text, outside))
    problems += _without_fixes(recording, imu, gnss)


def _without_fixes(recording: Recording, imu: RawImu, gnss: GnssFixes) -> Iterator[Problem]:
    """What to say where the IMU runs long before the first fix or on after the last: no result is given there."""
    seconds, share = LEAST_UNFIXED
    least = max(seconds, share * (imu.t[-1] - imu.t[0]))
    before, after = gnss.t[0] - imu.t[0], imu.t[-1] - gnss.t[-1]
    if before > least:
        text = f"the first fix comes {before:.0f} s after the IMU's first sample; nothing is smoothed before it"
        yield Problem(IMU_BEFORE_FIXES, f"{recording.gnss_file}: {text}")
    if after > least:
        text = f"the last fix comes {after:.0f} s before the IMU's last sample; nothing is smoothed after it"
        yield Problem(IMU_AFTER_FIXES, f"{recording.gnss_file}: {text}; did the GPS stop?")


def recordings(path: Path) -> list[LogFiles]:
    """Return the drives on a card, in order of their files' names; what calibrates the magnetometer is none.

    Empty where `path` is anything but a directory with the logger's files. Raises SessionError if none of them holds a
    recording.
    """
    files = list_files(path)
    if files.chosen is not None or not files.logs():
        return []
    from smoother.session.log import list_recordings

    return [recording for recording in list_recordings(files.logs()) if not recording.is_calibration]


def recording_on_card(file: Path) -> LogFiles | None:
    """Return the one of several drives on a card that a file belongs to; None where there are not several."""
    try:
        found = recordings(file.parent) if file.is_file() else []
    except SessionError:  # what is wrong is said when the session is read
        found = []
    mine = (recording for recording in found if file.name in [path.name for path in recording.paths])
    return next(mine, None) if len(found) > 1 else None


def place_of_its_own(path: Path) -> str:
    """Return what the folder for the results of a file is called if it is one of several recordings, else ""."""
    if (on_card := recording_on_card(path)) is not None:
        return on_card.name
    if not path.is_file() or path.name.lower() in OWN_NAMES:
        return ""
    return path.stem if list_files(path).others_beside() else ""


def _read_log(files: SessionFiles) -> Recording:
    from smoother.session.log import list_recordings, read_log, read_mag_calibration, without_copies

    present = list_recordings(files.logs())
    chosen, copies = without_copies(_choose(files, present))
    log = read_log(chosen)
    field, calibration = read_mag_calibration(chosen, present)
    inputs = tuple(path.name for path in (*chosen.paths, *(() if calibration is None else (calibration,))))
    file, problems = chosen.paths[0].name, [*log.problems, *copies]
    known = {path for recording in present for path in recording.paths}
    for path in (path for path in files.logs() if path not in known):
        problems.append(Problem("log_unusable", f"{path.name}: no whole block of a recording; left out"))
    return Recording(log.gnss, file, inputs, tuple(problems), log.imu, file, log.mag, field)


def _choose(files: SessionFiles, present: list[LogFiles]) -> LogFiles:
    """The recording that the named file belongs to, else the only drive."""
    if files.chosen is not None:
        for recording in present:
            if files.chosen[0] in recording.paths:
                return recording
        raise SessionError(f"{files.chosen[0].name}: no whole block of a recording; is it the logger's file?")
    drives = [recording for recording in present if not recording.is_calibration]
    if len(drives) == 1:
        return drives[0]
    if not drives:
        names = ", ".join(recording.paths[0].name for recording in present)
        raise SessionError(f"{files.directory}: only calibrations of the magnetometer ({names}); record a drive")
    names = ", ".join(recording.paths[0].name for recording in drives)
    raise SessionError(f"{files.directory}: holds {len(drives)} recordings ({names}); name the file of one")


def _read_thesis(files: SessionFiles) -> Recording:
    from smoother.session.thesis import read_magcalib, read_out

    out_file = files.out_file()
    assert out_file is not None
    out = read_out(out_file)
    inputs, problems, field = [out_file.name], list(out.problems), None
    if (magcalib := files.find("magcalib.txt", "mag_calib.txt")) is not None:
        field, magcalib_problems = read_magcalib(magcalib)
        inputs.append(magcalib.name)
        problems += magcalib_problems
    return Recording(out.gnss, out_file.name, tuple(inputs), tuple(problems), out.imu, out_file.name, out.mag, field)


def _read_columns(files: SessionFiles) -> Recording:
    """The CSV form, with fixes from gps.csv or from sentences."""
    from smoother.session.csv_form import find_restarts, read_imu_and_unit, read_mag
    from smoother.session.tables import NoRowsError
    from smoother.session.time_unit import lasts_like

    imu_table, mag_table = files.imu_table(), files.find("mag.csv", "mag.csv.gz")
    imu, mag, unit, restarts = None, None, None, None
    problems: list[Problem] = []
    if imu_table is not None:
        try:
            imu, problems, unit = read_imu_and_unit(imu_table)
        except NoRowsError as error:  # nothing in it can be mended, and fixes alone are a session
            problems.append(Problem("imu_empty", str(error)))
    elif (folder := files.folder(*IMU_NAMES)) is not None:
        problems.append(Problem("imu_folder", f"{folder}: a folder, where a table is wanted; nothing in it is read"))
    gnss, gnss_file, gnss_problems = _read_any_fixes(files, imu_table is not None, unit)
    if imu_table is not None and imu is not None:
        is_slow = unit is not None and not lasts_like(imu.t, gnss.t, unit)
        may_be_set_back = not _is_set_back(problems) or _is_set_back(gnss_problems)
        if is_slow or not may_be_set_back:
            imu, problems, unit = read_imu_and_unit(imu_table, may_be_set_back=may_be_set_back, is_slow=is_slow)
        if (fix_table := files.fix_table()) is not None and _is_restarted([*problems, *gnss_problems]):
            restarts = find_restarts(imu_table, fix_table, unit)
        if restarts is not None:
            imu, problems, unit = read_imu_and_unit(imu_table, is_slow=is_slow, shifts=restarts.samples)
            gnss, gnss_file, gnss_problems = _read_any_fixes(files, True, unit, restarts.fixes)
            problems.append(restarts.problem)
    problems += gnss_problems
    if mag_table is not None:
        try:
            mag, mag_problems = read_mag(
                mag_table,
                gnss.t,
                has_imu=imu is not None,
                imu_unit=unit,
                restarts=restarts,
                is_set_back=_is_set_back(problems),
            )
            problems += mag_problems
        except SessionError as error:  # a session is complete without it
            problems.append(Problem("mag_unusable", f"{error}; smoothed without magnetometer"))
    inputs = tuple(file.name for file in (imu_table, gnss_file, mag_table) if file is not None)
    return Recording(
        gnss, gnss_file.name, inputs, tuple(problems), imu, imu_table.name if imu_table is not None else "", mag
    )


def _is_set_back(problems: Sequence[Problem]) -> bool:
    """Whether a clock was set back; that of the samples is that of the fixes, which may know better."""
    return any(problem.code.endswith("_clock_set_back") for problem in problems)


def _is_restarted(problems: Sequence[Problem]) -> bool:
    return any(problem.code.endswith("_clock_restart") for problem in problems)


def _read_any_fixes(
    files: SessionFiles, has_imu: bool, imu_unit: str | None, shifts: Array | None = None
) -> tuple[GnssFixes, Path, list[Problem]]:
    """Fixes and what was wrong with them; shifts (K,) s : of the parts of gps.csv where its clock started again."""
    table, logs = files.fix_table(), files.sentence_logs()
    if table is not None:
        from smoother.session.csv_form import read_fixes

        gnss, problems = read_fixes(table, imu_unit, shifts)
        if logs and files.chosen is None:
            problems.append(Problem("gps_csv_preferred", _preferred(table.name, logs)))
        return gnss, table, problems
    from smoother.session.nmea import read_nmea

    log = logs[0]
    reading = read_nmea(log)
    problems = list(reading.problems)
    if len(logs) > 1:
        text = _preferred(f"{log.name}, the largest log,", logs[1:])
        problems.append(Problem("gps_other_logs", text, len(logs) - 1))
    if has_imu and not reading.has_receive_times:
        text = f"{log.name}: no receive times before the sentences; taken to start together with the IMU"
        problems.append(Problem("gps_clock_assumed", text))
    return reading.gnss, log, problems


def _foreign_reader(kind: Foreign) -> Callable[[Path], ForeignReading]:
    match kind:
        case "vbo":
            from smoother.session.vbo import read_vbo

            return read_vbo
        case "racechrono":
            from smoother.session.racechrono import read_racechrono

            return read_racechrono
        case "aim":
            from smoother.session.aim import read_aim

            return read_aim
        case "gpx":
            from smoother.session.gpx import read_gpx

            return read_gpx


def _read_foreign(files: SessionFiles) -> Recording:
    """A recording of another program, which stands in place of gps.csv and imu.csv."""
    (kind, path), *others = files.foreign_files()
    reading = _foreign_reader(kind)(path)
    problems = list(reading.problems)
    if others:
        text = _preferred(path.name, [other for _, other in others])
        problems.append(Problem("gps_other_logs", text, len(others)))
    if (table := files.imu_table()) is not None:
        problems.append(Problem("imu_unused", f"{table.name} is not used: it has not the clock of {path.name}"))
    return Recording(
        reading.gnss,
        path.name,
        (path.name,),
        tuple(problems),
        reading.imu,
        path.name,
        unix_at_zero=reading.unix_at_zero,
    )


def _own_of_columns(files: SessionFiles) -> list[Path]:
    tables = (files.imu_table(), files.fix_table())
    return [*(table for table in tables if table is not None), *files.sentence_logs()]


def _own_of_foreign(files: SessionFiles) -> list[Path]:
    imu = files.imu_table()
    return [*(path for _, path in files.foreign_files()), *([] if imu is None else [imu])]


FORMATS: tuple[Format, ...] = (
    Format("log", lambda files: bool(files.logs()), _read_log, SessionFiles.logs),
    Format("thesis", lambda files: files.out_file() is not None, _read_thesis, lambda files: []),
    Format(
        "columns",
        lambda files: files.fix_table() is not None or bool(files.sentence_logs()),
        _read_columns,
        _own_of_columns,
    ),
    Format("foreign", lambda files: bool(files.foreign_files()), _read_foreign, _own_of_foreign),
)
