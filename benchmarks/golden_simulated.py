"""Golden rows of simulated sessions: three presets, three tracks, with and without Doppler, magnetometer, holes."""

from dataclasses import dataclass
from pathlib import Path

from golden_command import Bench, read_table
from golden_measures import (
    RESULTS,
    has_results,
    run_columns,
    simulated_columns,
    true_lap_columns,
    truth_columns,
)
from golden_sessions import copy_of_simulated, simulated, true_figures
from golden_tables import Rows

ESTIMATOR = "smoother"  # of those that `smooth evaluate` compares


@dataclass(frozen=True)
class Simulated:
    """One simulated session; the name is that of its row."""

    name: str
    arguments: tuple[str, ...]
    quick: bool = False

    @property
    def rows(self) -> tuple[str, ...]:
        """Names of the rows this job gives."""
        return (self.name,)

    def run(self, bench: Bench, work: Path) -> Rows:
        """Smooth, evaluate, and measure."""
        source = simulated(bench, self.arguments)
        folder = work / self.name
        copy_of_simulated(source, folder)
        found, outcome = run_columns(bench, folder)
        if has_results(folder):
            truth = read_table(folder / "truth.csv")
            found |= truth_columns(read_table(folder / RESULTS / "trajectory.csv"), truth, outcome.document)
            found |= simulated_columns(outcome.document, true_figures(source))
            found |= true_lap_columns(outcome.document, truth)
            evaluated = bench.command("evaluate", "--json", folder.name, folder=folder.parent)
            found["evaluate.exit"] = evaluated.code
            nees = evaluated.document.get(ESTIMATOR, {}).get("nees")
            if nees is not None:
                found["nees"] = nees["mean"] / nees["dimension"]
        return {self.name: found}


def _session(name: str, preset: str, track: str, seed: int, seconds: int, *more: str, quick: bool = False) -> Simulated:
    common = ("--preset", preset, "--track", track, "--seed", str(seed), "--duration", str(seconds))
    return Simulated(name, (*common, *more), quick)


HOLES = ("--set", "imu.gaps=90:0.3,150:1,210:2")

SESSIONS = (
    _session("white_larkfield", "white", "larkfield", 1, 300, quick=True),
    _session("white_longmeadow_no_speed", "white", "longmeadow", 2, 300, "--no-speed"),
    _session("white_tinbarn_no_mag", "white", "tinbarn", 3, 300, "--no-mag"),
    _session("kart_larkfield", "kart", "larkfield", 1, 600),
    _session("kart_tinbarn", "kart", "tinbarn", 2, 400, quick=True),
    _session("kart_longmeadow_no_mag", "kart", "longmeadow", 3, 400, "--no-mag"),
    _session("kart_tinbarn_no_speed", "kart", "tinbarn", 4, 400, "--no-speed"),
    _session("kart_larkfield_holes", "kart", "larkfield", 5, 300, *HOLES),
    _session("kart_longmeadow_no_imu", "kart", "longmeadow", 6, 600, "--no-imu", "--no-mag", quick=True),
    _session("harsh_larkfield", "kart_harsh", "larkfield", 7, 600, "--no-mag"),
    _session("harsh_tinbarn", "kart_harsh", "tinbarn", 8, 400),
    _session("harsh_longmeadow_no_speed_no_mag", "kart_harsh", "longmeadow", 9, 400, "--no-speed", "--no-mag"),
)
