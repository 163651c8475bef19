"""Coverage-guided fuzzing of one reader with Atheris (libFuzzer), starting from the good files of its format.

    pip install atheris
    python tests/fuzz/fuzz_coverage.py vbo -max_total_time=600 -rss_limit_mb=2048 -timeout=10

Arguments after the format are libFuzzer's. The input is the file that matters most in a session of that format.
"""

import os
import sys
import tempfile
from pathlib import Path

os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import atheris

with atheris.instrument_imports(include=["smoother", "pynmea2", "tomllib", "json"]):
    from fuzz_campaign import check_readers
    from fuzz_corpus import CORPUS, Files, write_files

TARGETS = {  # name: format and the file of it that is fuzzed
    "log": ("log", ".KLG"),
    "thesis": ("thesis", "out.txt"),
    "magcalib": ("thesis", "magcalib.txt"),
    "imu": ("columns", "imu.csv"),
    "gps": ("columns", "gps.csv"),
    "settings": ("columns", "session.toml"),
    "calibration": ("columns", "calibration.toml"),
    "track": ("columns", "track.geojson"),
    "nmea": ("sentences", ".nmea"),
    "vbo": ("vbo", ".vbo"),
    "racechrono": ("racechrono", ".csv"),
    "aim": ("aim", ".csv"),
    "gpx": ("gpx", ".gpx"),
}


def main() -> None:
    """Hand one target to libFuzzer; it ends with the input that broke a rule, or when its time is over."""
    form, ending = TARGETS[sys.argv.pop(1)]
    files: Files = CORPUS[form]()
    target = next(name for name in files if name.lower().endswith(ending.lower()))
    with tempfile.TemporaryDirectory() as name:
        directory, seeds = Path(name) / "session", write_files(Path(name) / "seeds", {"good": files[target]})
        write_files(directory, files)

        def one_input(data: bytes) -> None:
            (directory / target).write_bytes(data)
            outcome = check_readers(directory)
            if outcome.kind == "finding":
                raise AssertionError(outcome.text)

        atheris.Setup([*sys.argv, "-max_len=65536", str(seeds)], one_input)
        atheris.Fuzz()


if __name__ == "__main__":
    main()
