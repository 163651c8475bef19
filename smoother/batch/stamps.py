"""Whether files are still what they were: by size and time of change, and where the time differs by their content.

So a folder that was copied or touched is not taken for a new one, and unchanged files are not read again.
"""

import hashlib
import os
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any


@dataclass(frozen=True)
class Stamp:
    """Bytes, time of change in ns, and SHA-256 of a file."""

    size: int
    changed_ns: int
    digest: str


def stamp(path: Path) -> Stamp:
    """Return the stamp of a file. Raises OSError."""
    with path.open("rb") as file:
        status = os.fstat(file.fileno())  # before it is read: a change meanwhile then shows as one
        return Stamp(status.st_size, status.st_mtime_ns, hashlib.file_digest(file, "sha256").hexdigest())


def stamps(paths: Iterable[Path], folder: Path) -> dict[str, Stamp]:
    """Return the stamps of files by their names as seen from `folder`; a file that cannot be read has none."""
    found = {}
    for path in paths:
        try:
            found[name_from(path, folder)] = stamp(path)
        except OSError:
            continue
    return found


def are_unchanged(known: Mapping[str, Stamp], paths: Iterable[Path], folder: Path) -> bool:
    """Whether these are the files of the stamps, none more and none less, and hold what they held."""
    named = {name_from(path, folder): path for path in paths}
    return named.keys() == known.keys() and all(is_unchanged(known[name], path) for name, path in named.items())


def is_unchanged(known: Stamp, path: Path) -> bool:
    """Whether a file holds what it held; it is read only where its time of change differs."""
    try:
        status = path.stat()
        if status.st_size != known.size:
            return False
        return status.st_mtime_ns == known.changed_ns or stamp(path).digest == known.digest
    except OSError:
        return False


def name_from(path: Path, folder: Path) -> str:
    """Return the path as seen from `folder`, so that both may be moved together."""
    return os.path.relpath(path, folder)


def to_plain(known: Mapping[str, Stamp]) -> dict[str, list[Any]]:
    """Return stamps as JSON holds them."""
    return {name: [one.size, one.changed_ns, one.digest] for name, one in known.items()}


def from_plain(document: Any) -> dict[str, Stamp]:
    """Return stamps from JSON. Raises ValueError where that holds something else."""
    if not isinstance(document, dict):
        raise ValueError("stamps are a table")
    made = {}
    for name, values in document.items():
        size, changed_ns, digest = values
        if not (isinstance(size, int) and isinstance(changed_ns, int) and isinstance(digest, str)):
            raise ValueError(f"no stamp of {name}")
        made[str(name)] = Stamp(size, changed_ns, digest)
    return made
