"""The firmware's core on this machine: its own tests under sanitizers, bounded fuzzing, what it writes read back."""

import shutil
import struct
import subprocess
import zlib
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from smoother.session.log_decode import decode, find_blocks, walk
from smoother.session.log_encode import encode
from smoother.session.log_format import (
    BLOCK_BYTES,
    GAP_NO_ROOM,
    GAP_SENSOR,
    GPS,
    IMU,
    MAG,
    TEMPERATURE,
    Event,
    Gap,
    LogRecords,
    SelfTest,
    Setup,
    Stop,
)
from smoother.session.log_frames import decode_frames, find_frames, lost_frames

FIRMWARE = Path(__file__).resolve().parents[2] / "firmware"
DATA = Path(__file__).resolve().parents[1] / "data"
SUITES = sorted(path.stem.removeprefix("test_") for path in (FIRMWARE / "tests" / "core").glob("test_*.c"))
SUITES += ["led"]  # beside the button in one file
WARNINGS = ("-std=c11", "-g", "-O1", "-Wall", "-Wextra", "-Wconversion", "-Wshadow", "-Wstrict-prototypes", "-Werror")
SANITIZERS = ("-fsanitize=address,undefined", "-fno-sanitize-recover=all")
FUZZ_RUNS = 30_000
HANGS_AFTER = 900  # s; ten are enough on a machine that does nothing else
SESSION = 4711
RING = 28  # blocks, as on the board


@pytest.fixture(scope="session")
def compiler():
    found = shutil.which("cc") or shutil.which("gcc") or shutil.which("clang")
    if found is None:
        pytest.skip("needs system package gcc")
    return found


def build(compiler, target, sources, *options):
    includes = [f"-I{FIRMWARE / part}" for part in ("core", "tests/core", "fuzz")]
    command = [compiler, *WARNINGS, *options, *includes, *map(str, sources), "-o", str(target)]
    done = subprocess.run(command, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return target


CORE = sorted((FIRMWARE / "core").glob("*.c"))


@pytest.fixture(scope="session")
def core_tests(compiler, tmp_path_factory):
    sources = [*CORE, FIRMWARE / "tests/core/main.c", *sorted((FIRMWARE / "tests/core").glob("test_*.c"))]
    return build(compiler, tmp_path_factory.mktemp("core") / "core_tests", sources, *SANITIZERS)


@pytest.fixture(scope="session")
def log_tool(compiler, tmp_path_factory):
    sources = [*CORE, FIRMWARE / "tests/core/log_tool.c"]
    return build(compiler, tmp_path_factory.mktemp("tool") / "log_tool", sources, *SANITIZERS)


@pytest.fixture(scope="session")
def walk_tool(compiler, tmp_path_factory):
    sources = [*CORE, FIRMWARE / "tests/core/walk_tool.c"]
    return build(compiler, tmp_path_factory.mktemp("walk") / "walk_tool", sources, *SANITIZERS)


@pytest.mark.parametrize("suite", SUITES)
def test_suite_of_the_core_passes_under_sanitizers(core_tests, suite):
    done = subprocess.run([core_tests, suite], capture_output=True, text=True, timeout=60)
    assert done.returncode == 0, done.stdout + done.stderr
    assert "ok " in done.stdout


def test_every_suite_is_run_here(core_tests):
    done = subprocess.run([core_tests], capture_output=True, text=True, timeout=60)
    assert {line.split()[1].rstrip(":") for line in done.stdout.splitlines()} == set(SUITES)


@pytest.mark.parametrize("target", ["config", "nmea", "block"])
def test_bounded_fuzzing_finds_nothing(compiler, tmp_path, target):
    sources = [*CORE, FIRMWARE / f"fuzz/fuzz_{target}.c", FIRMWARE / "fuzz/driver.c"]
    program = build(compiler, tmp_path / "fuzz", sources, *SANITIZERS)
    done = subprocess.run([program, str(FUZZ_RUNS)], capture_output=True, text=True, cwd=tmp_path, timeout=HANGS_AFTER)
    assert done.returncode == 0, done.stderr


def test_ring_is_free_of_data_races(compiler, tmp_path):
    sources = [FIRMWARE / "core/ring.c", FIRMWARE / "tests/core/ring_threads.c"]
    program = build(compiler, tmp_path / "threads", sources, "-fsanitize=thread", "-pthread")
    done = subprocess.run([program], capture_output=True, text=True, timeout=HANGS_AFTER)
    if "unexpected memory mapping" in done.stderr:
        pytest.skip("ThreadSanitizer does not run on this kernel")
    assert done.returncode == 0, done.stdout + done.stderr


def test_core_includes_only_itself_and_the_standard_library():
    allowed = {"limits", "stdatomic", "stdbool", "stddef", "stdint", "string"}
    for path in (FIRMWARE / "core").glob("*.[ch]"):
        for line in path.read_text(encoding="utf-8").splitlines():
            if line.startswith("#include <"):
                assert line.split("<")[1].split(".")[0] in allowed, path.name
            elif line.startswith("#include"):
                assert (FIRMWARE / "core" / line.split('"')[1]).exists(), path.name


def run_tool(log_tool, orders, ring=RING, now=0, session=SESSION):
    text = "\n".join(orders) + "\n"
    done = subprocess.run(
        [log_tool, str(ring), str(session), str(now)], input=text.encode(), capture_output=True, timeout=60
    )
    assert done.returncode == 0, done.stderr.decode()
    return done.stdout


def read_back(image):
    blocks, damaged = find_blocks(image)
    assert damaged == 0 and len(blocks) * BLOCK_BYTES == len(image)
    assert set(blocks.head["session"].tolist()) <= {SESSION}
    return decode(blocks)


SETUP = Setup(
    flags=0x1F,
    imu_who_am_i=0x73,
    mag_adjustment=b"\x11\x22\x33",
    reset_cause=0x44,
    gps_baud=115200,
    boot_number=70000,
    config_crc=0xDEADBEEF,
    firmware=bytes(range(8)),
    device=bytes(range(100, 112)),
)


def test_c_encodes_what_python_decodes_for_every_kind_of_record(log_tool):
    sentence, config = b"$GPRMC,104500.00,A*00\r\n", "imu_rate=1000\n" * 18
    orders = [
        *(f"setup 10 {SETUP.pack().hex()}", f"config 10 {config.encode().hex()}"),
        *("imu 1000 1 -2 32767 -32768 5 -6", "mag 1000 7 -8 9 1", "temperature 1000 -321"),
        *(f"gps 500 {sentence.hex()}", "event 1200 11 4000000000"),
        *("selftest 1300 -1 2 -3 4 -5 6 63 x0102030405ff", "lose 1 2 2000 4000 3", "imu 5000 1 2 3 4 5 6"),
        "stop 6000 1 17",
    ]
    records, losses = read_back(run_tool(log_tool, orders))
    assert records.setup == SETUP and records.config == config
    assert records.imu_t.tolist() == [1000, 5000]
    assert records.imu.tolist() == [[1, -2, 32767, -32768, 5, -6], [1, 2, 3, 4, 5, 6]]
    assert (records.mag_t.tolist(), records.mag.tolist(), records.mag_flags.tolist()) == ([1000], [[7, -8, 9]], [1])
    assert (records.temperature_t.tolist(), records.temperature.tolist()) == ([1000], [-321])
    assert records.sentences == ((500, sentence),)
    assert records.events == (Event(1200, 11, 4000000000),)
    assert records.self_tests == (SelfTest(1300, (-1, 2, -3, 4, -5, 6), bytes([1, 2, 3, 4, 5, 255]), 63),)
    assert records.gaps == (Gap(IMU, GAP_SENSOR, 3, 2000, 4000),)
    assert records.stop == Stop(6000, 1, 2, 3, 1, 1, 17)
    assert (losses.blocks, losses.samples, losses.unreadable) == (0, 0, 0)


def test_c_writes_the_golden_log(log_tool):
    orders = (DATA / "golden.orders").read_text(encoding="ascii").splitlines()
    assert run_tool(log_tool, orders, now=5_000_000, session=0x12345678) == (DATA / "golden.klg").read_bytes()


def test_python_reads_the_frames_that_c_writes(log_tool):
    orders = [f"imu {t} {t % 30000} 1 2 3 4 5" for t in range(0, 2**33, 2**33 // 50)]
    orders += [f"imu {2**33 + 1000 * i} {i} 0 0 0 0 0" for i in range(100)]
    stream = run_tool(log_tool, ["frame", *orders, "endframe"])
    frames, done = find_frames(stream)
    records = decode_frames(frames)
    assert done == len(stream) and lost_frames(frames) == 0
    assert [f"imu {t} {' '.join(map(str, row))}" for t, row in zip(records.imu_t, records.imu, strict=True)] == orders


kinds = st.sampled_from([1, 2, 3, 0x80, 0x81, 0x83, 0x88, 0xFF]) | st.integers(0, 255)
pieces = st.lists(st.tuples(kinds, st.integers(0, 40), st.binary(min_size=2, max_size=30)), max_size=20)


@settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(contents=st.lists(st.tuples(pieces, st.integers(0, 2**48 - 1), st.booleans()), min_size=1, max_size=5))
def test_both_readers_find_the_same_records_in_any_block(walk_tool, contents):
    """Records of known and unknown types, right and wrong lengths, in blocks with a right CRC, or a wrong one."""
    image = b"".join(make_block(i, *content) for i, content in enumerate(contents))
    done = subprocess.run([walk_tool], input=image, capture_output=True, timeout=60)
    assert done.returncode == 0, done.stderr.decode()
    lines = done.stdout.decode().split("\n")[:-1]
    blocks, _ = find_blocks(image)
    position, unreadable = walk(blocks)
    assert sum(line.endswith("unreadable") for line in lines) == unreadable
    assert [line for line in lines if not line.endswith("unreadable")] == [
        describe(blocks, at) for at in position.tolist()
    ]


def make_block(sequence, records, base, is_whole):
    """A block of records, each a type, the length it claims if it is long, and other bytes."""
    text = b"".join(
        bytes([kind]) + (bytes([length]) if kind >= 0x80 else b"") + rest for kind, length, rest in records
    )[:484]
    head = struct.pack("<4sIIIHHI", b"KLG\x01", 1, sequence, base & 0xFFFFFFFF, base >> 32, len(text), 0)
    block = (head + text).ljust(508, b"\0")
    return block + struct.pack("<I", zlib.crc32(block) ^ (not is_whole))


def describe(blocks, at):
    """What walk_tool prints of the record at a position in the joined blocks."""
    octets, block = blocks.content.reshape(-1), at // BLOCK_BYTES
    kind, is_long = int(octets[at]), octets[at] >= 0x80
    since = (
        int.from_bytes(octets[at + 2 : at + 6].tobytes(), "little", signed=True)
        if is_long
        else (int.from_bytes(octets[at + 1 : at + 3].tobytes(), "little"))
    )
    length = int(octets[at + 1]) if is_long else {1: 12, 2: 7, 3: 2}[kind]
    return f"{blocks.head['sequence'][block]} {kind} {blocks.base_us[block] + since} {length}"


def test_times_of_a_race_of_24_hours_come_back(log_tool):
    times = [0, 2**32 - 1, 2**32, 24 * 3600 * 10**6, 2**48 - 1]
    records, _ = read_back(run_tool(log_tool, [*(f"imu {t} 1 2 3 4 5 6" for t in times), "flush"]))
    assert records.imu_t.tolist() == times


@pytest.mark.parametrize("period", [1000, 5000, 20000])
def test_c_and_python_write_the_same_blocks(log_tool, period):
    """Samples, compass, temperature, sentences and settings of some seconds, laid out by both writers."""
    rng = np.random.default_rng(period)
    n = 6_000_000 // period
    t = np.cumsum(rng.integers(period - 20, period + 20, n))
    imu = rng.integers(-32768, 32768, (n, 6)).astype(np.int16)
    few = slice(None, None, max(1, 10000 // period))
    sentence = b"$GPRMC,104500.00,A,5000.12345,N,00800.12345,E,031.123,200.12,160526,,,A*50\r\n"
    sentences = tuple((int(s), sentence) for s in range(100_000, int(t[-1]) - 100_000, 200_000))
    setup = Setup(gps_baud=57600, imu_period_us=period)
    records = LogRecords(
        setup, "lowpass=92\n", t, imu, t[few], imu[few, :3], np.zeros(len(t[few]), np.uint8), sentences=sentences
    )
    orders = [(int(t[i]), 1, f"imu {t[i]} {' '.join(map(str, imu[i]))}") for i in range(n)]
    orders += [(int(t[i]), 2, f"mag {t[i]} {' '.join(map(str, imu[i, :3]))} 0") for i in range(n)[few]]
    orders += [(s + len(sentence) * 10**7 // 57600, 0, f"gps {s} {sentence.hex()}") for s, _ in sentences]
    for start in range(int(t[0]), int(t[-1]) + 1, 5_000_000):
        orders.append((start, -1, f"setup {start} {setup.pack().hex()}"))
        orders.append((start, -1, f"config {start} {records.config.encode().hex()}"))
    lines = [line for _, _, line in sorted(orders, key=lambda order: order[:2])]
    taken = [order for line in lines for order in (line, "take 1")]
    assert run_tool(log_tool, [*taken, "flush"], now=t[0]) == encode(records, SESSION)


SENTENCE = b"$GPRMC,1,A\r\n"

# A stream is a list of steps: samples of the sensor, and how many blocks the card takes after them.
steps = st.lists(
    st.tuples(st.integers(1, 120), st.integers(0, 4), st.booleans(), st.integers(0, 40)), min_size=1, max_size=60
)


def drive(stream):
    """Orders of a stream, and what was produced: times by source. Samples are 1 ms apart, sentences 70 ms old."""
    orders, made, t = [], {IMU: [], MAG: [], TEMPERATURE: [], GPS: []}, 100_000
    for samples, taken, has_sentence, sensor_lost in stream:
        for i in range(samples):
            t += 1000
            made[IMU].append(t)
            orders.append(f"imu {t} {i} 0 0 0 0 {t % 1000}")
            if len(made[IMU]) % 10 == 0:
                made[MAG].append(t)
                orders.append(f"mag {t} 1 2 3 0")
            if len(made[IMU]) % 100 == 0:
                made[TEMPERATURE].append(t)
                orders.append(f"temperature {t} 5")
        if sensor_lost:
            made[IMU] += range(t + 1000, t + 1000 * sensor_lost + 1, 1000)
            orders.append(f"lose {IMU} {GAP_SENSOR} {t + 1000} {t + 1000 * sensor_lost} {sensor_lost}")
            t += 1000 * sensor_lost
        if has_sentence:
            made[GPS].append(t - 70_000)
            orders.append(f"gps {t - 70_000} {SENTENCE.hex()}")
        orders.append(f"take {taken}")
    return [*orders, f"stop {t + 1000} 1 0"], made


@settings(max_examples=150, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(stream=steps, ring=st.integers(1, 6))
def test_any_stream_under_any_stalls_comes_back_or_is_counted_in_gaps(log_tool, stream, ring):
    orders, made = drive(stream)
    records, losses = read_back(run_tool(log_tool, orders, ring))
    read = {
        IMU: records.imu_t.tolist(),
        MAG: records.mag_t.tolist(),
        TEMPERATURE: records.temperature_t.tolist(),
        GPS: [t for t, _ in records.sentences],
    }
    for source, times in made.items():
        gaps = [gap for gap in records.gaps if gap.source == source]
        missing = sorted(set(times) - set(read[source]))
        assert sorted(read[source]) == sorted(set(times) - set(missing))
        assert sum(gap.count for gap in gaps) == len(missing)
        for gap in gaps:
            inside = [t for t in missing if gap.first_us <= t <= gap.last_us]
            assert len(inside) == gap.count and inside[0] == gap.first_us and inside[-1] == gap.last_us
    assert (losses.blocks, losses.samples) == (0, 0)
    assert records.stop is not None
    assert records.stop.imu_lost == sum(gap.count for gap in records.gaps if gap.source == IMU)
    assert records.stop.imu_records == len(records.imu_t)


@settings(max_examples=40, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(stalls=st.lists(st.tuples(st.integers(100, 2000), st.integers(1, 700)), min_size=1, max_size=6))
def test_stalls_of_700_ms_at_1_khz_lose_nothing(log_tool, stalls):
    """With the board's ring; between stalls the card catches up. Compass at 100 Hz and three sentences at 5 Hz."""
    orders, t = [], 0
    for calm, stall in stalls:
        for i in range(calm + stall):
            t += 1000
            orders += board_orders(t)
            orders += ["take 2"] if i < calm else []
        orders.append(f"take {RING}")
    records, losses = read_back(run_tool(log_tool, [*orders, "flush"], RING - 1))
    assert records.gaps == () and losses.samples == 0
    assert records.imu_t.tolist() == list(range(1000, t + 1, 1000))


def board_orders(t):
    """What the board records in the millisecond t (us)."""
    orders = [f"imu {t} 1 2 3 4 5 6"]
    orders += [f"mag {t} 1 2 3 0"] if t % 10_000 == 0 else []
    orders += [f"temperature {t} 1"] if t % 100_000 == 0 else []
    sentence = BOARD_SENTENCES.get(t % 200_000)
    return orders if sentence is None else [*orders, f"gps {t - len(sentence) * 174} {sentence.hex()}"]


BOARD_SENTENCES = {  # by the us within 200 ms at which the last byte is there, at 57600 baud
    14_000: b"$GPRMC,104500.00,A,5000.12345,N,00800.12345,E,031.123,200.12,160526,,,A*50\r\n",
    28_000: b"$GPGGA,104500.00,5000.12345,N,00800.12345,E,1,10,0.90,1120.0,M,47.0,M,,*5A\r\n",
    36_000: b"$GPGST,104500.00,12,,,,2.0,2.0,13.4*5A\r\n",
}


def longest_stall(log_tool, ring, calm):
    """Longest stall in ms that loses nothing with this ring, when it begins after `calm` ms."""
    orders, t = [], 0
    for _ in range(calm):
        t += 1000
        orders += [*board_orders(t), "take 2"]
    start = t
    for _ in range(1200):
        t += 1000
        orders += board_orders(t)
    records, _ = read_back(run_tool(log_tool, [*orders, f"take {ring}", *board_orders(t + 1000), "flush"], ring))
    first_lost = min(gap.first_us for gap in records.gaps if gap.source == IMU)
    return (first_lost - start) // 1000 - 1


def test_ring_of_the_board_rides_out_700_ms_and_one_block_less_does_not(log_tool):
    """The smallest margin over the phases at which a stall can begin; one block is in the card's hands all the time."""
    phases = range(60, 260, 5)
    margin = {ring: min(longest_stall(log_tool, ring - 1, phase) for phase in phases) for ring in (RING - 1, RING)}
    assert margin[RING] >= 700 > margin[RING - 1]


def test_struct_sizes_are_those_of_the_format():
    assert struct.calcsize("<4B3sBI6H5I8s12s") == len(Setup().pack()) == 64


def test_gaps_beyond_the_bound_are_explicit(log_tool):
    orders = [f"imu {t} 0 0 0 0 0 0" for t in range(1000, 1_001_000, 1000)]
    image = run_tool(log_tool, [*orders, f"take {RING}", "imu 1001000 0 0 0 0 0 0", "flush"])
    records, _ = read_back(image)
    stored = 32 * RING  # samples of 15 bytes in 484
    assert records.gaps == (Gap(IMU, GAP_NO_ROOM, 1000 - stored, 1000 * (stored + 1), 1_000_000),)
