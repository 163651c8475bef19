"""A stand-in for `smooth SESSION` that does what the session's file says: quick, and it can crash, hang and grow."""

from collections.abc import Callable

from smoother.batch.task import Task

SCRIPT = """
import json, os, pathlib, signal, sys, time
session, out = pathlib.Path(sys.argv[1]), pathlib.Path(sys.argv[3])
word, _, rest = (session / "gps.csv").read_text().partition(" ")
out.mkdir(parents=True, exist_ok=True)
with (session / "starts").open("a") as file:
    file.write("x")
staging = out / f".writing-{os.getpid()}"
staging.mkdir()
(staging / "trajectory.csv").write_text("half")
if word == "crash":
    os.kill(os.getpid(), signal.SIGSEGV)
if word == "hang":
    time.sleep(60)
if word == "grow":
    import resource  # a real session takes its memory after a second; this one waits for its bound to be set
    end = time.monotonic() + 10
    while resource.getrlimit(resource.RLIMIT_DATA)[0] == resource.RLIM_INFINITY and time.monotonic() < end:
        time.sleep(0.01)
    held = bytearray(1 << 30)
if word == "bug":
    raise ZeroDivisionError("a\\x1b[31m <b>")
if word == "unusable":
    print("smooth: one thing", f"smooth: {session}/gps.csv: no usable fix", sep="\\n", file=sys.stderr)
    sys.exit(2)
if word == "killed" and len((session / "starts").read_text()) <= int(rest):
    os.kill(os.getpid(), signal.SIGKILL)
if word == "slow":
    time.sleep(float(rest))
laps = [{"lap": 1, "lap_time_s": 61.5, "lap_time_sigma_s": 0.02, "valid": True}]
laps += [{"lap": 2, "lap_time_s": 60.25, "lap_time_sigma_s": 0.03, "valid": True}]
laps += [{"lap": 3, "lap_time_s": 11.0, "lap_time_sigma_s": 0.03, "valid": False}]
quality = {"passed": word != "doubtful", "reasons": ["far from the fixes"] if word == "doubtful" else []}
document = {"session": {"driver": "D"}, "laps": laps, "quality": quality, "origin": {"lat_deg": 45.0, "lon_deg": 12.0}}
document |= {"lap_analysis": {"track": "", "length_m": 900.0}, "problems": [{"code": "x"}]}
for name in ("trajectory.csv", "report.html"):
    (out / name).write_text("whole")
(out / "summary.json").write_text(json.dumps(document))
(staging / "trajectory.csv").unlink()
staging.rmdir()
sys.exit(0 if quality["passed"] else 3)
"""
STAND_IN = ("-S", "-c", SCRIPT)

MakeTask = Callable[..., Task]


def starts(task: Task) -> int:
    """How often the session was smoothed."""
    path = task.session / "starts"
    return len(path.read_text()) if path.exists() else 0
