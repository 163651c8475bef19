"""Which sessions lie under a folder, each with the files that decide its results. Looks at names and heads of files.

A folder that `smooth` could read is a session. One that holds several recordings holds as many sessions: a card of the
logger, or files of another program that each stand alone. Folders of results, hidden folders and links are passed over.
"""

import os
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from smoother.batch.task import Task, is_there
from smoother.calibration import FILE_NAME as CALIBRATION
from smoother.calibration import find_calibration
from smoother.errors import SmootherError, UsageError
from smoother.session.files import RESULTS, SessionFiles, list_files
from smoother.session.load import own_results_name
from smoother.session.settings import load_settings

OUTPUT_DIRECTORY = "smoothed"  # as `smooth SESSION` calls it
SETTINGS, OFFICIAL = "session.toml", "official.csv"
TABLES = tuple(f"{name}.csv{packed}" for packed in ("", ".gz") for name in ("imu", "gps", "mag", "wheel_speed"))
WHOLE = (*TABLES, "out.txt", "magcalib.txt", "mag_calib.txt")
KART = re.compile(r"(?i)kart(?:[ _-]?\d{1,3}[a-z]?|[ _-][a-z])")  # says itself that it is one: kart7, Kart 07, kart-12b
MOST_NAMED = 3  # of folders without a recording


@dataclass(frozen=True)
class Found:
    """The sessions of a batch, and in one line each what could not be searched."""

    tasks: tuple[Task, ...]
    problems: tuple[str, ...]


@dataclass(frozen=True)
class Recording:
    """One session of a folder: the path that names it, a name of its own where there are several, its files."""

    path: Path
    name: str
    files: tuple[Path, ...]


def find_sessions(roots: Sequence[Path], out: Path | None = None) -> Found:
    """Return the sessions under `roots` (folders, or a file of one session), each once, in order of their names.

    Results go beside each session, or under `out`, which then mirrors the folders. Raises UsageError for a root that
    is not there.
    """
    tasks: dict[Path, Task] = {}
    problems: list[str] = []
    for root, name in zip(roots, _names(roots), strict=True):
        if not root.exists():
            raise UsageError(f"{root}: no such file or folder")
        for task in _under(root.resolve(), name, out, problems):
            tasks.setdefault(task.session, task)
    found = sorted(tasks.values(), key=lambda task: _in_order(task.name))
    return Found(_with_places_of_their_own(found), tuple(problems))


def _names(roots: Sequence[Path]) -> list[str]:
    """What the roots are called, numbered where a name repeats."""
    names = [root.resolve().name or "sessions" for root in roots]
    resolved = [root.resolve() for root in roots]
    before = [len({resolved[k] for k in range(i) if names[k] == names[i]} - {resolved[i]}) for i in range(len(names))]
    return [f"{name}-{count + 1}" if count else name for name, count in zip(names, before, strict=True)]


def _in_order(name: str) -> list[list[str | int]]:
    """A key by which run 2 stands before run 10: of each folder, texts and numbers in turn."""
    parts = [re.split("([0-9]+)", folder) for folder in name.split("/")]
    return [[int(part) if i % 2 else part for i, part in enumerate(words)] for words in parts]


def _with_places_of_their_own(tasks: list[Task]) -> tuple[Task, ...]:
    """Number the folders of results where two sessions would share one."""
    taken: set[Path] = set()
    made = []
    for task in tasks:
        out, count = task.out, 1
        while out in taken:
            count += 1
            out = task.out.with_name(f"{task.out.name}-{count}")
        taken.add(out)
        made.append(replace(task, out=out))
    return tuple(made)


def _under(root: Path, name: str, out: Path | None, problems: list[str]) -> Iterator[Task]:
    if _holds_results(root if root.is_dir() else root.parent):
        problems.append(f"{root}: results, not a recording; name the folder it was made from")
        return
    if root.is_file():
        yield _task(_of_file(root), (name,), root.parent, out)
        return
    avoid = None if out is None else out.resolve()
    depths: set[int] = set()
    bare: list[Path] = []
    for folder, below, _ in os.walk(root, onerror=lambda error: problems.append(_unsearched(error))):
        here = Path(folder)
        if here == avoid or _holds_results(here):
            below.clear()
            continue
        below[:] = sorted(entry for entry in below if not entry.startswith(".") and entry != OUTPUT_DIRECTORY)
        try:
            recordings = recordings_in(here)
        except SmootherError as error:
            problems.append(str(error))
            continue
        except OSError as error:
            problems.append(_unsearched(error))
            continue
        parts = (name, *here.relative_to(root).parts)
        for recording in recordings:
            yield _task(recording, parts, here, out)
        if recordings:
            depths.add(len(parts))
        elif not below and not is_there(here / CALIBRATION):
            bare.append(here.relative_to(root))
    if missing := sorted(str(one) for one in bare if len(one.parts) + 1 in depths):
        problems.append(f"{root}: {_without_recording(missing)}")


def _kart(folders: Sequence[str]) -> str:
    """The folder that is called a kart, the session's own too, as of a card with one recording; else the one above."""
    called = [folder for folder in folders if KART.fullmatch(folder)]
    return called[-1] if called else folders[-2] if len(folders) > 2 else ""


def _without_recording(folders: Sequence[str]) -> str:
    """A line about folders beside sessions that hold none, as of a kart whose card was not copied."""
    more = f" and {len(folders) - MOST_NAMED} more" if len(folders) > MOST_NAMED else ""
    return f"no recording in {', '.join(folders[:MOST_NAMED])}{more}"


def _holds_results(folder: Path) -> bool:
    return all(is_there(folder / name) for name in RESULTS)


def _unsearched(error: OSError) -> str:
    return f"{error.filename}: cannot be searched ({error.strerror or error})"


def _task(recording: Recording, parts: tuple[str, ...], folder: Path, out: Path | None) -> Task:
    whole = (*parts, recording.name) if recording.name else parts
    place = _out_beside(folder, recording.name, out, "/".join(whole))
    return Task(recording.path, place, recording.files, "/".join(whole), _kart(whole))


def _out_beside(folder: Path, own: str, out: Path | None, name: str) -> Path:
    """SESSION/smoothed, there a folder of its own for each of several; or the same tree under `out`."""
    if out is not None:
        return out.resolve() / name
    return folder / OUTPUT_DIRECTORY / own if own else folder / OUTPUT_DIRECTORY


def recordings_in(folder: Path) -> list[Recording]:
    """Return the sessions of one folder, none where nothing in it is a recording of a drive.

    Files that cannot be read are a session too, so that the batch says what is wrong with it. Raises SessionError if
    the folder cannot be listed.
    """
    files = list_files(folder)
    if files.logs():
        return _of_card(files)
    tables = files.imu_table() is not None or files.fix_table() is not None or files.out_file() is not None
    if tables:
        is_bench = files.fix_table() is None and files.out_file() is None and not files.sentence_logs()
        return [] if is_bench and files.find(CALIBRATION) is not None else [_whole(files)]
    alone = files.sentence_logs() or [path for _, path in files.foreign_files()]
    if len(alone) < 2:
        return [_whole(files)] if alone else []
    by_stem = {path.stem: path for path in reversed(alone)}  # the better kind of one recording stands first
    return [Recording(by_stem[stem], stem, (by_stem[stem], *_shared(files))) for stem in sorted(by_stem)]


def _of_file(path: Path) -> Recording:
    """The session that a file was named for: one of several in its folder, or that which the folder is."""
    if (one := next((one for one in recordings_in(path.parent) if one.path == path), None)) is not None:
        return one
    try:
        name = own_results_name(path)
    except SmootherError:  # reported when the session is read
        name = ""
    return replace(_whole(list_files(path.parent)), path=path, name=name)


def _whole(files: SessionFiles) -> Recording:
    """The folder as one session; other files in it do not matter."""
    paths = [files.directory / name for name in files.names if name.lower() in WHOLE]
    paths += [*files.logs(), *files.sentence_logs(), *(path for _, path in files.foreign_files())]
    return Recording(files.directory, "", (*paths, *_shared(files)))


def _of_card(files: SessionFiles) -> list[Recording]:
    """The drives on a card of the logger; each depends on what calibrates the magnetometer as well."""
    from smoother.session.log import list_recordings

    try:
        found = list_recordings(files.logs())
    except SmootherError:
        return [_whole(files)]
    drives = [recording for recording in found if not recording.is_calibration]
    calibrations = tuple(path for recording in found if recording.is_calibration for path in recording.paths)
    if len(drives) == 1:
        return [_whole(files)]
    shared = (*calibrations, *_shared(files))
    return [Recording(drive.paths[0], drive.name, (*drive.paths, *shared)) for drive in drives]


def _shared(files: SessionFiles) -> tuple[Path, ...]:
    """The files that every session of a folder depends on: settings, calibration, official times, the track's file."""
    settings = files.find(SETTINGS)
    track = None if settings is None else _track_file(settings)
    there = (settings, files.find(OFFICIAL), find_calibration(files.directory), track)
    return tuple(path for path in there if path is not None)


def _track_file(settings: Path) -> Path | None:
    """The file of lines that session.toml names, if it lies in the folder of the session, as it has to."""
    folder = settings.parent
    try:
        named = load_settings(settings).track
        path = None if named is None else folder / named.partition("#")[0].strip()
        is_there = path is not None and path.is_file() and path.resolve().is_relative_to(folder.resolve())
    except (SmootherError, OSError, ValueError, RuntimeError):
        return None  # reported when the session is read
    return path if is_there else None
