"""Files a person wrote, small ones, and files we write: bounded when read, whole or not at all when written."""

import contextlib
import errno
import json
import os
import shutil
import signal
import threading
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

from smoother.errors import ConfigError, SmootherError

LARGEST = 16 << 20  # bytes; the settings of a session have 1 kB, the lines of all tracks of the world some megabytes
STAGING = ".writing-"  # and the number of the process, of a directory whose files are not yet results


def load_toml(path: Path, remedy: str = "mend that line") -> dict[str, Any]:
    """Read a TOML file. Raises ConfigError, one line, where it is too large, too deep, unreadable, or none."""
    import tomllib  # most sessions state nothing, and need not wait for it

    document: dict[str, Any] = _parsed(path, path.name, tomllib.loads, "TOML", f"; {remedy}")
    return document


def load_json(path: Path) -> Any:
    """Read a JSON file. Raises ConfigError, one line, where it is too large, too deep, unreadable, or none."""
    return _parsed(path, str(path), json.loads, "JSON")


def _parsed(path: Path, name: str, parse: Callable[[str], Any], kind: str, remedy: str = "") -> Any:
    try:
        return parse(_text(path))
    except UnicodeDecodeError as error:
        line = error.object.count(b"\n", 0, error.start) + 1  # as older editors of Windows write umlauts
        raise ConfigError(f"{name}: line {line} is not in UTF-8; save it as UTF-8") from error
    except (ValueError, RecursionError) as error:
        raise ConfigError(f"{name}: not valid {kind} ({_reason(error)}){remedy}") from error


def _text(path: Path) -> str:
    too_large = f"{path.name}: larger than {LARGEST >> 20} MB; this is no file of settings"
    return read_bounded(path, ConfigError, too_large).decode("utf-8-sig")


def read_bounded(path: Path, error: type[SmootherError], too_large: str) -> bytes:
    """Return what a person wrote to a file. Raises `error`: `too_large` beyond LARGEST, or why it is unreadable."""
    try:
        with path.open("rb") as file:
            data = file.read(LARGEST + 1)
    except OSError as reason:
        raise error(f"{path}: cannot be read ({reason.strerror or reason})") from reason
    if len(data) > LARGEST:
        raise error(too_large)
    return data


def _reason(error: Exception) -> str:
    if isinstance(error, RecursionError):
        return "nested too deeply"
    return " ".join(str(error).split())[:200]


@contextlib.contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """Give a temporary path beside `path`, renamed to it on success and removed on failure."""
    temporary = path.with_name(f".{path.name}.{os.getpid()}.tmp")
    try:
        yield temporary
        temporary.replace(path)
    finally:
        temporary.unlink(missing_ok=True)


@contextlib.contextmanager
def staged(directory: Path, seal: str, stale: Sequence[str] = ()) -> Iterator[Path]:
    """Give a directory whose files go to `directory` together, on success; on failure or a kill nothing changes.

    Who ends the run while they go has to wait for the last of them.

    seal : the file that says the results are whole: the old one goes first and the new one comes last. `stale` :
    what an earlier run may have left there and is removed where this one has not written it, with folders that leaves
    empty.
    """
    staging = directory / f"{STAGING}{os.getpid()}"
    _remove_abandoned(directory)
    try:
        staging.mkdir()
        yield staging
        written = [path.relative_to(staging) for path in sorted(staging.rglob("*")) if path.is_file()]
        if folder := next((directory / name for name in written if (directory / name).is_dir()), None):
            raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR), str(folder))
        with _undisturbed():
            (directory / seal).unlink(missing_ok=True)
            for name in sorted(written, key=lambda name: name == Path(seal)):
                (directory / name).parent.mkdir(parents=True, exist_ok=True)
                (staging / name).replace(directory / name)
            for old in set(stale) - {name.as_posix() for name in written}:
                (directory / old).unlink(missing_ok=True)
                _remove_empty((directory / old).parent, directory)
    finally:
        shutil.rmtree(staging, ignore_errors=True)


@contextlib.contextmanager
def _undisturbed() -> Iterator[None]:
    """Hold back Ctrl-C and a wish to end until the block is done; only the main thread gets these."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    held: list[int] = []
    before = {one: signal.signal(one, lambda number, _: held.append(number)) for one in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield
    finally:
        for one, handler in before.items():
            signal.signal(one, signal.SIG_DFL if handler is None else handler)
        if held:
            signal.raise_signal(held[0])


def _remove_empty(folder: Path, within: Path) -> None:
    """Remove a folder below `within` where nothing is left in it."""
    if folder != within:
        with contextlib.suppress(OSError):  # it holds something, or is gone already
            folder.rmdir()


def _remove_abandoned(directory: Path) -> None:
    """Remove what killed runs left."""
    for path in directory.glob(f"{STAGING}*"):
        process = path.name.removeprefix(STAGING)
        if process.isdecimal() and not _is_running(int(process)):
            shutil.rmtree(path, ignore_errors=True)


def _is_running(process: int) -> bool:
    try:
        os.kill(process, 0)
    except (ProcessLookupError, OverflowError):
        return False
    except PermissionError:
        return True
    return process != os.getpid()
