"""The formats a session may be recorded in: how each is recognised in a directory, and read to a Recording.

A format is one entry of `FORMATS`; the first that recognises what lies in the directory reads it. The module that
reads a format is imported when one is met, because a session has one of them. Several files of a format, and those that
go together, are sorted out here; what a file holds is for its own module.
"""

from __future__ import annotations

import importlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from smoother.errors import SessionError
from smoother.samples import GnssFixes, Problem
from smoother.session.files import IMU_NAMES, Foreign, SessionFiles, list_files
from smoother.session.recording import Recording

if TYPE_CHECKING:
    from smoother.session.log import LogFiles
    from smoother.session.readers.foreign import ForeignReading

CALLED = {"mag": "magnetometer", "wheel_speed": "wheel speed", "channels": "channels"}  # tables beside, for people


@dataclass(frozen=True)
class Format:
    """One way a session may be recorded: whether it is there, how to read it, and which files it speaks of itself."""

    name: str
    recognises: Callable[[SessionFiles], bool]
    read: Callable[[SessionFiles], Recording]
    own: Callable[[SessionFiles], list[Path]]


def preferred(used: str, others: Sequence[Path]) -> str:
    """Return the sentence about recordings that are not used; their number stands in it, being the problem's count."""
    names = ", ".join(path.name for path in others)
    count = "" if len(others) == 1 else f"{len(others)} others: "
    return f"{used} is used, not {count}{names}; name a file to have that one"


def _read_log(files: SessionFiles) -> Recording:
    from smoother.session.log import list_recordings, read_log, read_mag_calibration

    present = list_recordings(files.logs())
    chosen = _choose(files, present)
    log = read_log(chosen)
    field, calibration = read_mag_calibration(chosen, present)
    inputs = tuple(path.name for path in (*chosen.paths, *(() if calibration is None else (calibration,))))
    file, problems = chosen.paths[0].name, list(log.problems)
    known = {path for recording in present for path in recording.paths}
    for path in (path for path in files.logs() if path not in known):
        problems.append(Problem("log_unusable", f"{path.name}: no whole block of a recording; left out"))
    return Recording(log.gnss, file, inputs, tuple(problems), log.imu, file, log.mag, field, imu_delay=log.imu_delay)


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
    from smoother.session.beside import SessionClock, read_channels, read_mag, read_wheel_speed
    from smoother.session.csv_form import read_imu_and_unit
    from smoother.session.tables import NoRowsError
    from smoother.session.time_unit import lasts_like

    imu_table = files.imu_table()
    imu, unit = None, None
    problems: list[Problem] = []
    if imu_table is not None:
        try:
            imu, problems, unit = read_imu_and_unit(imu_table)
        except NoRowsError as error:  # nothing in it can be mended, and fixes alone are a session
            problems.append(Problem("imu_empty", str(error)))
    problems += [
        Problem("imu_folder", f"{name}: {kind}, where a table is wanted; nothing in it is read")
        for name, kind in files.no_files(*IMU_NAMES).items()
    ]
    gnss, gnss_file, gnss_problems = _read_any_fixes(files, imu_table is not None, unit)
    if imu_table is not None and imu is not None:
        if unit is not None and not lasts_like(imu.t, gnss.t, unit):
            imu, problems, unit = read_imu_and_unit(imu_table, is_slow=True)
        _require_one_run(imu_table.name, gnss_file.name, problems, gnss_problems)
    problems += gnss_problems
    inputs = [file.name for file in (imu_table, gnss_file) if file is not None]
    clock = SessionClock(gnss.t, imu is not None, unit)
    beside: dict[str, Any] = {}
    for name, read in (("mag", read_mag), ("wheel_speed", read_wheel_speed), ("channels", read_channels)):
        table = files.find(f"{name}.csv", f"{name}.csv.gz")
        if table is None:
            continue
        inputs.append(table.name)
        try:
            beside[name], said = read(table, clock)
            problems += said
        except SessionError as error:  # a session is complete without it
            problems.append(Problem(f"{name}_unusable", f"{error}; smoothed without {CALLED[name]}"))
    imu_file = imu_table.name if imu_table is not None else ""
    return Recording(gnss, gnss_file.name, tuple(inputs), tuple(problems), imu, imu_file, **beside)


def _require_one_run(imu: str, fixes: str, of_imu: Sequence[Problem], of_fixes: Sequence[Problem]) -> None:
    """Raise SessionError where both clocks started again: the longest part of each may be of different drives."""
    restarted = [any(problem.code.endswith("_clock_restart") for problem in said) for said in (of_imu, of_fixes)]
    if all(restarted):
        raise SessionError(f"{imu} and {fixes}: t_s starts again in both; split both files there, a session each")


def _read_any_fixes(files: SessionFiles, has_imu: bool, imu_unit: str | None) -> tuple[GnssFixes, Path, list[Problem]]:
    """Fixes and what was wrong with them."""
    table, logs = files.fix_table(), files.sentence_logs()
    if table is not None:
        from smoother.session.csv_form import read_fixes

        gnss, problems = read_fixes(table, imu_unit)
        if logs and files.chosen is None:
            problems.append(Problem("gps_csv_preferred", preferred(table.name, logs)))
        return gnss, table, problems
    from smoother.session.nmea import read_nmea

    log = logs[0]
    reading = read_nmea(log)
    problems = list(reading.problems)
    if log.name.lower().endswith(".csv"):
        problems.append(Problem("gps_sentences", f"{log.name}: NMEA sentences, and no table; read as such"))
    if len(logs) > 1:
        text = preferred(f"{log.name}, the largest log,", logs[1:])
        problems.append(Problem("gps_other_logs", text, len(logs) - 1))
    if has_imu and not reading.has_receive_times:
        text = f"{log.name}: no receive times before the sentences; taken to start together with the IMU"
        problems.append(Problem("gps_clock_assumed", text))
    return reading.gnss, log, problems


def _read_foreign(files: SessionFiles) -> Recording:
    """A recording of another program, which stands in place of gps.csv and imu.csv."""
    from smoother.session.readers.sets import KINDS, chapters_of, read_native, read_tables, sensors_of

    (kind, path), *others = files.foreign_files()
    paths, rest = [path], [other for _, other in others]
    if kind == "gopro":
        paths = chapters_of(path, files.of_kind(kind))
    elif kind == "table":
        alike = [other for other in files.of_kind(kind) if other != path]
        paths = [path, *sensors_of(path, files.sensor_tables(), alike)]
    if kind in KINDS:
        reading = read_native(kind, paths)
    elif kind == "table":
        reading = read_tables(path, paths[1:])
    else:
        reading = _reader_of_one(kind)(path)
    problems, rest = list(reading.problems), [other for other in rest if other not in paths]
    if rest:
        problems.append(Problem("gps_other_logs", preferred(path.name, rest), len(rest)))
    if (table := files.imu_table()) is not None:
        problems.append(Problem("imu_unused", f"{table.name} is not used: it has not the clock of {path.name}"))
    names = tuple(one.name for one in paths)
    return Recording(
        reading.gnss,
        path.name,
        names,
        tuple(problems),
        reading.imu,
        path.name,
        unix_at_zero=reading.unix_at_zero,
        channels=reading.channels,
    )


def _reader_of_one(kind: Foreign) -> Callable[[Path], ForeignReading]:
    """The reader of a kind of which a recording is one file."""
    module, name = {"vbo": ("vbo", "read_vbo"), "ubx": ("ubx", "read_ubx")}.get(kind, ("tracks", "read_track"))
    reader: Callable[[Path], ForeignReading] = getattr(
        importlib.import_module(f"smoother.session.readers.{module}"), name
    )
    return reader


def _read_archive(files: SessionFiles) -> Recording:
    """A recording in an archive, as a phone's logger shares it."""
    from smoother.session.readers.sets import unpacked

    archive = files.archives()[0]
    with unpacked(archive) as folder:
        inside = list_files(folder)
        form = next((form for form in FORMATS[:-1] if form.recognises(inside)), None)
        if form is None:
            raise SessionError(f"{archive.name}: no recording in it; unpack it, then name what was in it")
        recording = form.read(inside)
    return replace(recording, inputs=(archive.name,))


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
    Format("archive", lambda files: bool(files.archives()), _read_archive, SessionFiles.archives),
)
