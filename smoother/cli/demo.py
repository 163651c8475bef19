"""`smooth demo [DIR]`: simulate and smooth a session."""

from __future__ import annotations

from pathlib import Path

import click

from smoother.cli.arguments import ABOUT_EXIT, EXIT_DONE, EXIT_QUALITY, Number, Whole
from smoother.cli.directories import OUTPUT_DIRECTORY
from smoother.cli.output import open_page, print_line, progress_on_terminal, warn
from smoother.cli.pipeline import Options, smooth_session
from smoother.cli.simulating import TRACKS, write
from smoother.cli.tables import show_result

PRESET, SEED = "kart", 2026  # the seed is a year; nothing is tuned to it
LAPSES = 4.0  # mistakes a kilometre, so that corners show losses


@click.command(short_help="No recording yet? Simulate one and smooth it.", epilog=ABOUT_EXIT)
@click.argument(
    "directory", metavar="[DIR]", required=False, default="demo", type=click.Path(path_type=Path, file_okay=False)
)
@click.option(
    "--duration",
    metavar="S",
    type=Number(20.0, 3600.0),
    default=240.0,
    envvar="SMOOTH_DEMO_SECONDS",
    help="Seconds driven [240, or SMOOTH_DEMO_SECONDS].",
)
@click.option("--seed", type=Whole(0), default=SEED, help=f"Another session [{SEED}].")
@click.option("--track", type=click.Choice(TRACKS), default=TRACKS[0], help=f"Another track [{TRACKS[0]}].")
@click.option("--open", "open_it", is_flag=True, help="Show the report when done.")
def demo(directory: Path, duration: float, seed: int, track: str, open_it: bool) -> int:
    """Simulate a kart session as the logger would record it into DIR [./demo], and smooth it into DIR/smoothed.

    The last line is the path of the report: open it in a browser. `smooth evaluate DIR` compares the result with the
    truth.
    """
    from smoother.sim.simulation import simulate_preset

    with progress_on_terminal() as progress:
        progress("simulating", 0.0)
        simulation = simulate_preset(PRESET, seed, track=track, duration=duration, motion_lapse_rate=LAPSES)
        write(simulation, directory, "klg")
        result = smooth_session(directory, directory / OUTPUT_DIRECTORY, Options(), progress)
    if not result.quality.passed:
        warn(f"{directory}: the result failed its quality gate: {'; '.join(result.quality.reasons)}")
    print_line(
        f"Simulated kart session (preset {PRESET}, seed {seed}) in {directory}, smoothed into {result.directory}"
    )
    show_result(result)
    if open_it:
        open_page(result.main_file)
    return EXIT_DONE if result.quality.passed else EXIT_QUALITY
