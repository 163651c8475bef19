"""Results on disk: whole or as they were before, whatever ends the run; disks that are full or locked."""

import os
import resource
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from fuzz_corpus import CORPUS, write_files

from smoother.documents import STAGING, replacing, staged

SEAL = "summary.json"
SMOOTH = (sys.executable, "-c", "from smoother.cli import main; main()")


def contents(directory: Path) -> dict[str, bytes]:
    return {p.relative_to(directory).as_posix(): p.read_bytes() for p in directory.rglob("*") if p.is_file()}


def test_results_appear_together_and_replace_the_old_ones(tmp_path: Path) -> None:
    write_files(tmp_path, {SEAL: b"old", "a.csv": b"old", "b.csv": b"old", "mine.txt": b"mine"})
    with staged(tmp_path, SEAL, stale=("b.csv",)) as staging:
        (staging / "figures").mkdir()
        write_files(staging, {SEAL: b"new", "a.csv": b"new", "figures/x.png": b"new"})
        assert contents(tmp_path)["a.csv"] == b"old"
    assert contents(tmp_path) == {SEAL: b"new", "a.csv": b"new", "figures/x.png": b"new", "mine.txt": b"mine"}


def test_who_stops_the_run_while_results_appear_has_them_whole(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    write_files(tmp_path, {SEAL: b"old", "a.csv": b"old"})
    given = signal.signal(signal.SIGINT, signal.default_int_handler)  # a shell's background ignores it
    replace, before = Path.replace, signal.getsignal(signal.SIGINT)

    def interrupted(self: Path, target: Path) -> Path:
        signal.raise_signal(signal.SIGINT)
        return replace(self, target)

    monkeypatch.setattr(Path, "replace", interrupted)
    with pytest.raises(KeyboardInterrupt), staged(tmp_path, SEAL) as staging:
        write_files(staging, {SEAL: b"new", "a.csv": b"new"})
    assert contents(tmp_path) == {SEAL: b"new", "a.csv": b"new"}
    assert signal.getsignal(signal.SIGINT) is before
    signal.signal(signal.SIGINT, given)


def test_a_failed_run_leaves_the_old_results(tmp_path: Path) -> None:
    before = {SEAL: b"old", "a.csv": b"old"}
    write_files(tmp_path, before)
    with pytest.raises(OSError, match="full"), staged(tmp_path, SEAL) as staging:
        (staging / "a.csv").write_bytes(b"half")
        raise OSError("full")
    assert contents(tmp_path) == before


def test_a_replaced_file_is_old_or_new(tmp_path: Path) -> None:
    path = tmp_path / "a.toml"
    path.write_text("old")
    with pytest.raises(OSError, match="full"), replacing(path) as temporary:
        temporary.write_text("ne")
        raise OSError("full")
    assert contents(tmp_path) == {"a.toml": b"old"}


def test_a_killed_run_leaves_the_old_results_and_the_next_run_cleans_up(tmp_path: Path) -> None:
    before = {SEAL: b"old", "a.csv": b"old"}
    write_files(tmp_path, before)
    script = (
        "import sys, time; from pathlib import Path; from smoother.documents import staged\n"
        f"with staged(Path(sys.argv[1]), '{SEAL}') as s:\n"
        "    (s / 'a.csv').write_text('half'); print('ready', flush=True); time.sleep(60)"
    )
    run = subprocess.Popen([sys.executable, "-c", script, str(tmp_path)], stdout=subprocess.PIPE)
    assert run.stdout is not None
    with run.stdout:
        assert run.stdout.readline() == b"ready\n"
        run.send_signal(signal.SIGKILL)
        run.wait()
    assert {name: data for name, data in contents(tmp_path).items() if not name.startswith(STAGING)} == before
    with staged(tmp_path, SEAL) as staging:
        write_files(staging, {SEAL: b"new"})
    assert contents(tmp_path) == {SEAL: b"new", "a.csv": b"old"}


def command(session: Path, kilobytes: int | None = None, *options: str) -> subprocess.CompletedProcess[str]:
    """Run the command in a process that may write files of no more than so many kilobytes: like a disk that is full."""

    def limit() -> None:
        signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
        if kilobytes is not None:
            resource.setrlimit(resource.RLIMIT_FSIZE, (kilobytes * 1024, kilobytes * 1024))

    call = [*SMOOTH, str(session), "--no-figures", "--no-baseline", *options]
    return subprocess.run(call, capture_output=True, text=True, preexec_fn=limit, check=False, cwd=session)


@pytest.fixture
def session(tmp_path: Path) -> Path:
    return write_files(tmp_path / "session", CORPUS["columns"]())


@pytest.mark.parametrize("kilobytes", [0, 5, 100])
def test_a_full_disk_gives_one_line_and_keeps_the_old_results(kilobytes: int, session: Path) -> None:
    before = {SEAL: b"{}", "trajectory.csv": b"old"}
    write_files(session / "smoothed", before)
    done = command(session, kilobytes)
    assert done.returncode == 2
    assert done.stderr.count("\n") == 1
    assert "cannot be written" in done.stderr
    assert contents(session / "smoothed") == before


@pytest.mark.skipif(os.geteuid() == 0, reason="a superuser may write everywhere")
def test_a_locked_disk_gives_one_line(session: Path) -> None:
    session.chmod(0o555)
    done = command(session, None, "--out", str(session / "out"))
    session.chmod(0o755)
    assert (done.returncode, done.stderr.count("\n")) == (2, 1)


def test_a_run_killed_at_any_time_leaves_the_old_results_or_the_new_ones(session: Path) -> None:
    assert command(session).returncode == 0
    names = set(contents(session / "smoothed"))
    for delay in (0.3, 1.0, 1.6, 2.2):
        call = [*SMOOTH, str(session), "--no-figures", "--no-baseline"]
        run = subprocess.Popen(call, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        time.sleep(delay)
        run.kill()
        run.wait()
        left = contents(session / "smoothed")
        whole = {name for name in left if not name.startswith(STAGING)}
        assert whole == names or SEAL not in whole
        assert left["trajectory.csv"].endswith(b"\n")
