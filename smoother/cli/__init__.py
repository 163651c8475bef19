"""Arguments, progress, exit codes and the only print()."""

import sys
from typing import NoReturn


def main() -> None:
    """Run the command line and leave with its exit code.

    The import is here, because Ctrl-C during it is no bug either.
    """
    try:
        from smoother.cli.main import main as run_and_leave

        run_and_leave()
    except KeyboardInterrupt:
        _leave_stopped()
    except (ImportError, RuntimeError) as error:  # raised for Ctrl-C by C modules, and by classes in Python 3.11
        if not isinstance(error.__cause__, KeyboardInterrupt):
            raise
        _leave_stopped()


def _leave_stopped() -> NoReturn:
    if sys.stderr is not None:  # closed (`2>&-`)
        sys.stderr.write("smooth: stopped\n")
    sys.exit(130)  # EXIT_INTERRUPTED, which may not be there yet
