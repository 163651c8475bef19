"""Arguments, progress, exit codes and the only print()."""

from smoother.cli.main import main

__all__ = ["main"]
