"""Readers that rest on libraries of other people, run in a process of their own: if one crashes, that is one line.

What such a library prints does not reach the terminal, and it gets no more memory and time than a reading needs.
As a program: KIND FILES.. OUT reads the files and stores their sheets in OUT.
"""

import contextlib
import importlib
import importlib.util
import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from smoother.errors import SessionError
from smoother.session.readers.sheet import Column, Sheet, sheet_of

MOST_MEMORY = 4 << 30  # bytes of addresses; libraries reserve more than they use
LONGEST = 120.0  # s; an hour of a log takes three, a damaged one may keep a library busy for good


@dataclass(frozen=True)
class Kind:
    """A kind of file that is read in a child: its reader's module, the library and the extra that brings it."""

    module: str
    library: str
    extra: str
    called: str


KINDS = {
    "xrk": Kind("smoother.session.readers.xrk", "libxrk", "aim", "a log of an AiM logger"),
    "gopro": Kind("smoother.session.readers.gopro", "py_gpmf_parser", "gopro", "a video of a GoPro"),
    "fit": Kind("smoother.session.readers.fit", "fitdecode", "fit", "a FIT file"),
}


def sheets_in(kind: str, paths: Sequence[Path]) -> list[Sheet]:
    """Return the sheets of the files of one recording. Raises SessionError, one line, where there are none."""
    of, file = KINDS[kind], paths[0].name
    if importlib.util.find_spec(of.library) is None:
        raise SessionError(f"{file}: {of.called}; to read it: pip install 'kart-smoother[{of.extra}]'")
    with tempfile.TemporaryDirectory() as directory:
        out = Path(directory) / "sheets.npz"
        command = [sys.executable, "-m", "smoother.session.readers.child", kind, *map(_absolute, paths), str(out)]
        environment = {**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, sys.path)), "PYTHONWARNINGS": "ignore"}
        try:
            done = subprocess.run(
                command, capture_output=True, timeout=LONGEST, stdin=subprocess.DEVNULL, env=environment, check=False
            )
        except subprocess.TimeoutExpired:
            raise SessionError(f"{file}: {of.library} did not finish with it in {LONGEST:.0f} s") from None
        if done.returncode or not out.exists():
            raise SessionError(f"{file}: {_reason(of, done.returncode)}; copy it from the device again")
        return _stored(out, file)


def _absolute(path: Path) -> str:
    return str(path.absolute())


def _reason(kind: Kind, code: int) -> str:
    ended = f"ended by signal {-code}" if code < 0 else f"ended with {code}"
    return f"{kind.library} cannot read it ({ended}); it is damaged, or not {kind.called}"


def _stored(path: Path, file: str) -> list[Sheet]:
    """The sheets that a child stored. Raises SessionError where it stored why there are none."""
    with np.load(path, allow_pickle=False) as arrays:
        contents = json.loads(str(arrays["contents"]))
        if "error" in contents:
            raise SessionError(f"{file}: {contents['error']}")
        sheets = []
        for i, sheet in enumerate(contents["sheets"]):
            values = arrays[f"sheet{i}"]
            columns = [Column(name, values[k], unit) for k, (name, unit) in enumerate(sheet["columns"])]
            sheets.append(sheet_of(file, columns, sensor=sheet["sensor"], about=sheet["about"]))
    return sheets


def _store(path: Path, sheets: Sequence[Sheet]) -> None:
    contents = [
        {"columns": [(c.name, c.unit) for c in sheet.columns], "sensor": sheet.sensor, "about": sheet.about}
        for sheet in sheets
    ]
    arrays = {f"sheet{i}": np.stack([c.values for c in sheet.columns]) for i, sheet in enumerate(sheets)}
    np.savez(path, contents=np.array(json.dumps({"sheets": contents})), **arrays)  # type: ignore[arg-type]


def main(arguments: Sequence[str]) -> int:
    """Read the files of a kind, and store their sheets, or in one line why there are none."""
    kind, *files, out = arguments
    with contextlib.suppress(ImportError, ValueError):  # no such limits on every system
        import resource

        resource.setrlimit(resource.RLIMIT_AS, (MOST_MEMORY, MOST_MEMORY))
        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    nothing = os.open(os.devnull, os.O_WRONLY)
    os.dup2(nothing, 1)
    os.dup2(nothing, 2)
    read: Callable[[Sequence[Path]], list[Sheet]] = importlib.import_module(KINDS[kind].module).sheets
    try:
        _store(Path(out), read([Path(file) for file in files]))
    except SessionError as error:
        np.savez(Path(out), contents=np.array(json.dumps({"error": str(error)})))
    except Exception as error:  # whatever a library raises at a damaged file; a crash is reported by the parent
        text = " ".join(str(error).split())[:120] or type(error).__name__
        np.savez(Path(out), contents=np.array(json.dumps({"error": f"{KINDS[kind].library} cannot read it ({text})"})))
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
