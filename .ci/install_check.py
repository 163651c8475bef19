"""Build the wheel from the checkout and try it where nothing of the checkout is: `smooth demo` in a clean environment.

    python .ci/install_check.py                                    the Python that runs this, newest dependencies
    python .ci/install_check.py --every-python --bounds both       every supported Python that is found, both ends
    python .ci/install_check.py --bounds lowest --tests tests/fit  and some of the tests against what was installed

An environment is made anew for each Python, in a temporary folder; pip installs the wheel and its dependencies into it.
`lowest` takes the oldest version of each direct dependency that pyproject.toml allows and that has a wheel for that
Python (`uv`, of the extra `release`, finds them). Prints a line for each environment; exit code 1 if one failed.
"""

import argparse
import os
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
SHIPPED = ("smoother", "calib", "pyproject.toml", "README.md", "LICENSE")
SUPPORTED = ((3, 11), (3, 12), (3, 13), (3, 14))
BOUNDS = ("lowest", "highest")
RESULTS = ("trajectory.csv", "summary.json", "report.html", "laps.csv", "figures/overview.png")
FROM_OUTSIDE = ("PYTHONPATH", "PYTHONHOME", "VIRTUAL_ENV", "SMOOTH_DATA")
SHOWN = ("gtsam", "numpy", "scipy", "polars", "matplotlib")  # whose versions the printed line has
TELL_VERSION = "import sys; print(*sys.version_info[:2])"
TELL_PLACES = "import smoother, calib; print(smoother.__file__); print(calib.__path__[0])"


class CheckError(Exception):
    """A step that failed, with what it printed."""


@dataclass(frozen=True)
class Place:
    """A clean environment: its Python, and the versions it was held to ("lowest", "highest")."""

    python: Path
    bounds: str


def run(command: list[str | Path], folder: Path, **environment: str) -> str:
    """Run a command in a folder, with nothing of the checkout in its environment; what it printed, or CheckError."""
    kept = {name: value for name, value in os.environ.items() if name not in FROM_OUTSIDE}
    done = subprocess.run(
        [str(word) for word in command],
        cwd=folder,
        env=kept | environment,
        text=True,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        check=False,
    )
    if done.returncode:
        raise CheckError(f"{' '.join(map(str, command))}\n{done.stdout[-4000:]}")
    return done.stdout


def version_of(python: str | Path) -> tuple[int, int] | None:
    """Major and minor version of a Python, None if it does not run."""
    try:
        major, minor = run([python, "-c", TELL_VERSION], Path("/")).split()
    except (CheckError, OSError, ValueError):
        return None
    return int(major), int(minor)


def every_python() -> Iterator[Path]:
    """One Python of each supported version: on the path, or where pyenv keeps them."""
    for version in SUPPORTED:
        name = ".".join(map(str, version))
        pyenv = Path(os.environ.get("PYENV_ROOT", Path.home() / ".pyenv")) / "versions"
        candidates = [shutil.which(f"python{name}"), *sorted(pyenv.glob(f"{name}.*/bin/python")), sys.executable]
        fitting = [Path(one) for one in candidates if one and version_of(one) == version]
        if fitting:
            yield fitting[0]
        else:
            print(f"Python {name}: none found, not checked", flush=True)


def build_wheel(folder: Path) -> Path:
    """Build from a copy of what ships, so that nothing an earlier build left behind gets in."""
    source = folder / "source"
    source.mkdir()
    for name in SHIPPED:
        if (ROOT / name).is_dir():
            shutil.copytree(ROOT / name, source / name, ignore=shutil.ignore_patterns("__pycache__"))
        else:
            shutil.copy(ROOT / name, source / name)
    run([sys.executable, "-m", "pip", "wheel", "--quiet", "--no-deps", "-w", folder / "wheel", source], folder)
    (wheel,) = (folder / "wheel").glob("*.whl")
    return wheel


def constraints(place: Place, folder: Path, extra: list[str]) -> list[str | Path]:
    """What pip has to be told so that it takes the versions wanted."""
    if place.bounds == "highest":
        return []
    version = ".".join(map(str, version_of(place.python) or ()))
    pinned = folder / "lowest.txt"
    resolve = [sys.executable, "-m", "uv", "pip", "compile", "--quiet", "--resolution", "lowest-direct", "--no-build"]
    wanted = [f"--extra={name}" for name in extra]
    run([*resolve, "--python-version", version, *wanted, "-o", pinned, ROOT / "pyproject.toml"], folder)
    return ["-c", pinned]


def install(place: Place, wheel: Path, folder: Path, extra: list[str]) -> Path:
    """Make a clean environment and install the wheel into it; its folder of programs."""
    venv = folder / "venv"
    run(["sh", ROOT / ".ci" / "venv.sh", venv], folder, PYTHON=str(place.python))
    programs = venv / "bin"
    wanted = f"{wheel}[{','.join(extra)}]" if extra else str(wheel)
    limits = constraints(place, folder, extra)
    run([programs / "python", "-m", "pip", "install", "--quiet", "--only-binary", ":all:", *limits, wanted], folder)
    run([programs / "python", "-m", "pip", "check"], folder)
    return programs


def try_demo(programs: Path, folder: Path, seconds: float, **environment: str) -> None:
    """Run the demo as somebody would who has only the wheel. Raises CheckError."""
    away = folder / "away"
    away.mkdir()
    for place in run([programs / "python", "-c", TELL_PLACES], away, **environment).split():
        if not Path(place).is_relative_to(programs.parent):
            raise CheckError(f"{place} is not of the environment")
    run([programs / "smooth", "--help"], away, **environment)
    run([programs / "smooth", "demo", "demo"], away, SMOOTH_DEMO_SECONDS=str(seconds), **environment)
    missing = [name for name in RESULTS if not (away / "demo" / "smoothed" / name).is_file()]
    if missing:
        raise CheckError(f"smooth demo left no {', '.join(missing)}")


def versions(programs: Path, folder: Path) -> str:
    """Versions of the larger dependencies, for the line that is printed."""
    listed = run([programs / "python", "-m", "pip", "list", "--format=freeze"], folder).split()
    found = dict(row.split("==", 1) for row in listed if "==" in row)
    return ", ".join(f"{name} {found[name]}" for name in SHOWN)


def check(place: Place, wheel: Path, seconds: float, tests: list[str]) -> bool:
    """Try one environment; print what came of it."""
    version = ".".join(map(str, version_of(place.python) or ()))
    since = time.monotonic()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        try:
            programs = install(place, wheel, folder, ["test"] if tests else [])
            try_demo(programs, folder, seconds)
            told = versions(programs, folder)
            if tests:
                # the program, not `python -m`: the folder it runs in is not to be imported from; and what is old may
                # warn about what is new
                pytest: list[str | Path] = [programs / "pytest", "-o", "filterwarnings=default", *tests]
                told += "; " + run(pytest, ROOT).strip().splitlines()[-1]
        except CheckError as error:
            print(f"Python {version}, {place.bounds}: FAILED\n{error}", flush=True)
            return False
    print(f"Python {version}, {place.bounds}: ok in {time.monotonic() - since:.0f} s ({told})", flush=True)
    return True


def main() -> int:
    """Check what was asked for; the exit code."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--python", action="append", type=Path, default=[], help="a Python to try; may be repeated")
    parser.add_argument("--every-python", action="store_true", help="every supported Python that is found")
    parser.add_argument("--bounds", choices=[*BOUNDS, "both"], default="highest", help="of the dependencies' versions")
    parser.add_argument("--seconds", type=float, default=60.0, help="length of the demo's drive [60]")
    parser.add_argument("--tests", nargs="+", default=[], help="tests to run against what was installed")
    options = parser.parse_args()
    pythons = [*options.python, *(every_python() if options.every_python else [])] or [Path(sys.executable)]
    ends = BOUNDS if options.bounds == "both" else (options.bounds,)
    with tempfile.TemporaryDirectory() as name:
        wheel = build_wheel(Path(name))
        done = [check(Place(python, end), wheel, options.seconds, options.tests) for python in pythons for end in ends]
    return 0 if all(done) else 1


if __name__ == "__main__":
    sys.exit(main())
