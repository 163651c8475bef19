"""The commands that have a name, each imported when it is used, so that smoothing starts fast."""

from importlib import import_module

import click

_MODULES = {  # in the order of the help
    "calibrate": "calibrating",
    "check": "checking",
    "demo": "demo",
    "simulate": "simulating",
    "evaluate": "evaluating",
    "export": "exporting",
    "laps": "lapping",
    "compare": "comparing",
    "live": "living",
    "batch": "batching",
}
COMMAND_NAMES = tuple(_MODULES)


def named_command(name: str) -> click.Command:
    """Return one of the commands in COMMAND_NAMES; it is called as its function in `smoother.cli`."""
    command = getattr(import_module(f"smoother.cli.{_MODULES[name]}"), name)
    assert isinstance(command, click.Command)
    return command
