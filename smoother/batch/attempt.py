"""Smooth one session in a process of its own, whatever it does: crash, hang, grow, be killed.

The process is the command that a person would type, in a fresh interpreter: nothing of one session reaches the next,
and an interpreter whose libraries have started threads cannot safely be forked. The start costs about a second of
processor time, a tenth of a session of ten minutes.
"""

import contextlib
import os
import resource
import shutil
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import IO

from smoother import threads
from smoother.batch import record
from smoother.batch.outcome import Cost, Outcome, State, facts_of_results, facts_of_settings, one_line
from smoother.batch.task import ERROR_LOG, Limits, Task
from smoother.documents import STAGING
from smoother.errors import SmootherError

COMMAND = ("-P", "-m", "smoother.cli")  # -P: no module of the working directory stands in for ours
"""Arguments of Python for each session."""
STARTS = 2  # of a session that something outside killed: the system, short of memory for all, or a person
OUT_OF_MEMORY = ("MemoryError", "bad_alloc", "memory allocation of", "Cannot allocate memory", "can't start new thread")


class Stopped(Exception):
    """The batch was stopped while a session ran; what the session had written is gone."""


@dataclass(frozen=True)
class Ended:
    """How a process ended: its exit code (negative: the signal), whether it ran out of time, its cost, its stderr."""

    code: int
    is_late: bool
    cost: Cost
    stderr: str


def attempt(task: Task, stop: threading.Event | None = None, command: Sequence[str] = COMMAND) -> Outcome:
    """Smooth one session and write its record; return what became of it, never raise for what a session did.

    Raises Stopped soon after `stop` is set.
    """
    stop = stop or threading.Event()
    inputs = record.digests(task.inputs, task.folder)
    try:
        ended = _until_it_ends_itself(task, stop, command)
    except OSError as error:
        return Outcome("broken", one_line(f"no process could be started ({error.strerror or error})"))
    outcome = _judged(task, ended)
    with contextlib.suppress(OSError):  # a full disk: the outcome stands, and next time the session is smoothed again
        _keep_stderr(task, outcome, ended)
        if outcome.has_results:
            record.keep(task, inputs, outcome)
    return outcome


def _until_it_ends_itself(task: Task, stop: threading.Event, command: Sequence[str]) -> Ended:
    ended = _run(task, stop, command)
    starts = 1
    while ended.code in (-signal.SIGKILL, -signal.SIGTERM) and not ended.is_late and starts < STARTS:
        ended, starts = _run(task, stop, command), starts + 1
    return replace(ended, cost=replace(ended.cost, starts=starts))


def _run(task: Task, stop: threading.Event, command: Sequence[str]) -> Ended:
    """Run the process to its end, or to that of its time. Raises Stopped, OSError."""
    call = [sys.executable, *command, str(task.session), "--out", str(task.out), *task.arguments]
    surroundings = {**os.environ, **dict.fromkeys(threads.VARIABLES, "1"), "PYTHONFAULTHANDLER": "1", "NO_COLOR": "1"}
    start, new = time.monotonic(), _not_there(task.out)
    with tempfile.TemporaryFile() as words:
        process = subprocess.Popen(
            call,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=words,
            env=surroundings,
            start_new_session=True,  # what it started can be ended with it, and Ctrl-C is for us to handle
        )
        try:
            _limit(process.pid, task.limits)
            usage, is_late = _wait(process, start + task.limits.seconds, stop)
        finally:
            _clear(process, task.out, new)
        cost = Cost(time.monotonic() - start, usage.ru_utime + usage.ru_stime, _megabytes(usage))
        return Ended(process.returncode, is_late or process.returncode == -signal.SIGXCPU, cost, _last_of(words))


def _limit(pid: int, limits: Limits) -> None:
    """Bound the memory that a process may write to, and as a net below our own clock its processor time."""
    if sys.platform == "linux":
        try:
            resource.prlimit(pid, resource.RLIMIT_DATA, (limits.megabytes << 20,) * 2)
            resource.prlimit(pid, resource.RLIMIT_CPU, (int(limits.seconds) + 60,) * 2)
        except (ProcessLookupError, PermissionError, ValueError):  # it has ended, or a lower bound was already there
            pass


def _wait(process: subprocess.Popen[bytes], end: float, stop: threading.Event) -> tuple[resource.struct_rusage, bool]:
    """Return what the process used, and whether it was ended for its time. Raises Stopped."""
    is_late = False
    while True:
        pid, status, usage = os.wait4(process.pid, os.WNOHANG)
        if pid:
            process.returncode = os.waitstatus_to_exitcode(status)
            return usage, is_late
        if stop.is_set():
            raise Stopped
        if time.monotonic() > end:
            is_late = True
            _kill(process)
        stop.wait(0.02)  # s between polls of a process


def _kill(process: subprocess.Popen[bytes]) -> None:
    try:
        os.killpg(process.pid, signal.SIGKILL)
    except (ProcessLookupError, PermissionError):  # it has just ended
        process.kill()


def _not_there(folder: Path) -> list[Path]:
    """A folder and those above it that have still to be made, the deepest first."""
    return [one for one in (folder, *folder.parents) if not one.exists()]


def _clear(process: subprocess.Popen[bytes], out: Path, new: Sequence[Path]) -> None:
    """End the process if it still runs, and remove what it had begun to write, of `new` folders those left empty."""
    if process.returncode is None:
        _kill(process)
        process.wait()
    shutil.rmtree(out / f"{STAGING}{process.pid}", ignore_errors=True)
    with contextlib.suppress(OSError):  # the first that holds something, or was not made, ends it
        for folder in new:
            folder.rmdir()


def _megabytes(usage: resource.struct_rusage) -> float:
    return usage.ru_maxrss / (1024.0 if sys.platform == "linux" else 1024.0**2)  # kB there, bytes on macOS


def _last_of(words: IO[bytes]) -> str:
    # bytes of the standard error of a process that are kept, the last ones
    words.seek(max(0, words.seek(0, os.SEEK_END) - 65536))
    return words.read().decode("utf-8", errors="replace")


# ---- judging --------------------------------------------------------------------------------------------------------


def _judged(task: Task, ended: Ended) -> Outcome:
    """Return what became of the session, from how its process ended."""
    if ended.code in (0, 3):
        try:
            facts, reasons = facts_of_results(task.out)
        except (SmootherError, ValueError, TypeError, AttributeError) as error:
            return Outcome("broken", one_line(f"its summary cannot be read: {error}"), cost=ended.cost)
        message = one_line("the result failed its quality gate: " + "; ".join(reasons)) if reasons else ""
        return Outcome("doubtful" if ended.code == 3 or reasons else "done", message, facts, ended.cost)
    state, message = _failure(task, ended)
    return Outcome(state, one_line(message), facts_of_settings(task), ended.cost)


def _failure(task: Task, ended: Ended) -> tuple[State, str]:
    lines = [line.strip() for line in ended.stderr.splitlines() if line.strip()]
    if ended.is_late:
        return "limit", f"not finished after {task.limits.seconds:g} s (--time-limit)"
    if ended.code == 2:
        return "unusable", _reason(task, lines)
    if any(word in line for word in OUT_OF_MEMORY for line in lines):
        return "limit", f"needs more than {task.limits.megabytes} MB of memory (--memory-limit)"
    last = lines[-1] if lines else "no message"
    if ended.code < 0:
        name = signal.Signals(-ended.code).name if -ended.code in set(signal.Signals) else str(-ended.code)
        again = f", {ended.cost.starts} times" if ended.cost.starts > 1 else ""
        return "broken", f"the process was ended by {name}{again}"
    return "broken", f"a bug in this program: {last} (all of it in {ERROR_LOG})"


def _reason(task: Task, lines: list[str]) -> str:
    """The last line of stderr, without the name of the session."""
    last = lines[-1] if lines else "no reason was given"
    return last.removeprefix("smooth: ").removeprefix(f"{task.session}: ").removeprefix(f"{task.session}/")


def _keep_stderr(task: Task, outcome: Outcome, ended: Ended) -> None:
    """Keep the standard error of a run that broke beside its results; that of earlier runs is removed."""
    path = task.out / ERROR_LOG
    if outcome.state == "broken" and ended.stderr:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(ended.stderr, encoding="utf-8", errors="replace")
    else:
        path.unlink(missing_ok=True)
