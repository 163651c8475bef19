"""Why files that look like a recording are none: never written, or under another name."""

from pathlib import Path

from smoother.session.files import SessionFiles

SUFFIXES = (".csv", ".txt", ".nmea", ".vbo", ".gpx", ".klg", ".log", ".dat")
HEAD_BYTES = 4096
CHUNK = 1 << 20  # bytes
NEVER_WRITTEN = "only zero bytes: it was never written; copy it from the card again"


def holds_only_zeros(path: Path) -> bool:
    """Whether there are bytes in a file, and all are zero, as where a card has room reserved and nothing was stored."""
    size = 0
    try:
        with path.open("rb") as file:
            while chunk := file.read(CHUNK):
                if chunk.strip(b"\0"):
                    return False
                size += len(chunk)
    except OSError:
        return False  # whoever needs the file will say so
    return size > 0


def unrecognised(files: SessionFiles) -> str | None:
    """Return why a file that may be a recording is not recognised, with what to do; None if nothing is to be said."""
    from smoother.session.log_format import MAGIC  # the types beside it are for those who read a log

    for path in _candidates(files):
        try:
            with path.open("rb") as file:
                head = file.read(HEAD_BYTES)
        except OSError:
            continue
        if head.startswith(MAGIC):
            return f"{path.name} is a log of the logger; call it *.klg"
        if holds_only_zeros(path):
            return f"{path.name}: {NEVER_WRITTEN}"
    return None


def _candidates(files: SessionFiles) -> list[Path]:
    """The file that was named, else all that are called as a recording may be."""
    if files.chosen is not None:
        return [files.chosen[0]]
    return [files.directory / name for name in files.names if name.lower().endswith(SUFFIXES)]
