"""`smooth simulate DIR`: a session with known truth, in the formats the reader knows."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from smoother.cli.arguments import Number, Whole
from smoother.cli.output import print_line, print_pairs, progress_on_terminal
from smoother.documents import staged
from smoother.errors import UsageError
from smoother.words import counted, duration

if TYPE_CHECKING:
    from smoother.sim.simulation import Simulation

PRESETS, TRACKS = ("white", "kart", "kart_harsh"), ("larkfield", "tinbarn", "longmeadow")
SIMULATED_FILES = (
    *("imu.csv", "gps.csv", "mag.csv", "wheel_speed.csv", "out.txt", "magcalib.txt", "LOG00001.KLG", "LOG00002.KLG"),
    *("truth.csv", "session.toml", "calibration.toml"),
)
SIMULATION_MARK = "truth_laps.csv"  # marks a folder whose simulated files may be overwritten


@click.command(short_help="Write a simulated session with its truth.")
@click.argument("directory", metavar="DIR", required=False, type=click.Path(path_type=Path, file_okay=False))
@click.option("--preset", type=click.Choice(PRESETS), default="kart", help="Quality of sensors and GPS [kart].")
@click.option("--seed", type=Whole(0), default=1, help="Seed of the random numbers [1].")
@click.option("--track", type=click.Choice(TRACKS), default=TRACKS[0], help=f"Track [{TRACKS[0]}].")
@click.option("--duration", metavar="S", type=Number(5.0, 90000.0), default=300.0, help="Duration in seconds [300].")
@click.option(
    "--format", "form", type=click.Choice(["csv", "klg", "thesis"]), default="csv", help="Files to write [csv]."
)
@click.option("--imu-rate", metavar="HZ", type=Number(1.0, 2000.0), help="Motion samples a second.")
@click.option("--gps-rate", metavar="HZ", type=Number(0.1, 50.0), help="Fixes a second.")
@click.option("--standstill", metavar="S", type=Number(0.0), help="Seconds at rest before the start.")
@click.option("--no-imu", is_flag=True, help="GPS only.")
@click.option("--no-mag", is_flag=True, help="No compass.")
@click.option("--no-speed", is_flag=True, help="Fixes without speed and course.")
@click.option(
    "--told", "states_truth", is_flag=True, help="Write the true mounting, noise and latencies into session.toml."
)
@click.option("--set", "settings", metavar="NAME=VALUE", multiple=True, help="Any other value; --list shows them.")
@click.option("--list", "list_them", is_flag=True, help="List every value of this preset.")
def simulate(
    directory: Path | None, settings: tuple[str, ...], list_them: bool, form: str, states_truth: bool, **choices: Any
) -> int:
    """Simulate a kart session into DIR, with truth.csv beside it for `smooth evaluate`.

    Every noise can be set, in SI units: --set gnss.white_horizontal=0.5 --set imu.gyro_noise=0.02
    --set gnss.outages=60:5,120:10 (start:length in seconds).
    """
    from smoother.cli.scenario_settings import listed, parsed
    from smoother.sim.simulation import simulate_preset

    changes = {**_common_changes(choices), **parsed(settings)}
    if list_them:
        print_pairs(f"preset {choices['preset']}", listed(choices["preset"], choices["seed"], changes))
        return 0
    if directory is None:
        raise UsageError("no folder given: smooth simulate DIR; see `smooth simulate --help`")
    if form == "thesis" and choices["no_imu"]:
        raise UsageError("--format thesis cannot hold a session without IMU; leave out --no-imu, or write csv")
    with progress_on_terminal() as progress:
        progress("simulating", 0.0)
        names = {name: choices[name] for name in ("track", "duration")}
        simulation = simulate_preset(choices["preset"], choices["seed"], **names, **changes)
        progress("writing", 0.5)
        write(simulation, directory, form, states_truth)
    raw, length = simulation.raw, duration(choices["duration"])
    samples = 0 if raw.imu is None else len(raw.imu.t)
    text = f"{length}, {counted(len(raw.gnss), 'fix')}, {counted(samples, 'IMU sample')}, seed {choices['seed']}"
    print_pairs(raw.name, [("simulated", text)])
    print_line(str(directory))
    return 0


def write(simulation: Simulation, directory: Path, form: str, states_truth: bool = False) -> None:
    """Write a simulation into a directory that is new, empty of sessions, or an earlier simulation.

    Raises UsageError rather than write over a recording, or where nothing can be written.
    """
    from smoother.sim.record import write_csv, write_settings, write_thesis, write_title
    from smoother.sim.record_log import write_klg

    _require_nothing_else(directory)
    try:
        directory.mkdir(parents=True, exist_ok=True)
        # files of another format or of further sensors would be read with the new ones, so they are removed
        with staged(directory, SIMULATION_MARK, SIMULATED_FILES) as staging:
            {"csv": write_csv, "klg": write_klg, "thesis": write_thesis}[form](simulation, staging)
            write_toml = write_settings if states_truth else write_title
            # a .KLG holds the latency itself, and the thesis' logger did not know it
            write_toml(simulation, staging / "session.toml", states_delay=form == "csv")
    except OSError as error:
        raise UsageError(f"{directory}: cannot be written ({error.strerror or error}); name another folder") from error


def _require_nothing_else(directory: Path) -> None:
    """Raise UsageError where a folder has a recording that no simulation wrote: it would be overwritten or ignored."""
    from smoother.session.files import list_files

    if not directory.is_dir():
        return
    found = [path.name for path in list_files(directory).recordings()]
    found += [name for name in SIMULATED_FILES if (directory / name).exists()]
    is_simulated = (directory / SIMULATION_MARK).exists()
    if foreign := [name for name in found if not (is_simulated and name in SIMULATED_FILES)]:
        raise UsageError(
            f"{directory}: holds a recording ({foreign[0]}) that would be lost or ignored; name another folder"
        )


def _common_changes(choices: dict[str, Any]) -> dict[str, Any]:
    """The options for common parameters, as changes of the scenario."""
    named = {"imu_rate": "imu.rate", "gps_rate": "gnss.rate", "standstill": "motion.standstill"}
    changes = {key: choices[option] for option, key in named.items() if choices[option] is not None}
    changes |= {"imu": None} if choices["no_imu"] else {}
    changes |= {"mag": None} if choices["no_mag"] else {}
    changes |= {"gnss.velocity": False} if choices["no_speed"] else {}
    return changes
