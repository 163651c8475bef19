"""A port that fails and comes back, a sender that is too fast: nothing freezes, and it says what it lost."""

import contextlib
import os
import pty
import threading
import time
import tty
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from live_here import Foreground, LocalNavigator
from smoother.errors import UsageError
from smoother.live.engine import Engine
from smoother.live.frame import Frame
from smoother.live.receiver import MOST_WAITING, READ_AHEAD, Chunk, Receiver
from smoother.live.running import run
from smoother.live.sources import READ_BYTES, PipeSource, ReplaySource, SerialSource, source_for


class Port:
    """A pseudo-terminal under a name that stays when the cable is pulled and plugged in again."""

    def __init__(self, link: Path) -> None:
        self.link = link
        self.plug_in()

    def plug_in(self) -> None:
        self.controller, self._terminal = pty.openpty()
        tty.setraw(self._terminal)
        self.link.unlink(missing_ok=True)
        self.link.symlink_to(os.ttyname(self._terminal))

    def pull(self) -> None:
        self.link.unlink()
        os.close(self._terminal)
        os.close(self.controller)

    def write(self, data: bytes) -> None:
        while data:
            data = data[os.write(self.controller, data[:1024]) :]


@pytest.fixture
def port(tmp_path: Path) -> Iterator[Port]:
    made = Port(tmp_path / "ttyUSB0")
    yield made
    with contextlib.suppress(OSError):  # a test has pulled it
        made.pull()


class Shown:
    """A view that remembers what it was given."""

    frames_a_second = 25.0

    def __init__(self) -> None:
        self.delays: list[float] = []

    def draw(self, frame: Frame) -> bool:
        self.delays.append(frame.delay)
        return True


def wait_until(condition: object, seconds: float = 10.0) -> None:
    end = time.monotonic() + seconds
    while not condition():  # type: ignore[operator]
        assert time.monotonic() < end, "it did not happen in time"
        time.sleep(0.01)


def test_a_pulled_cable_is_noticed_and_the_stream_goes_on_when_it_is_back(port: Port, drive) -> None:
    engine, first, second = Engine(LocalNavigator(Foreground())), drive.stream[:20_000], drive.stream[30_000:50_000]
    with Receiver(SerialSource(str(port.link))) as receiver:
        wait_until(lambda: receiver.status.is_open)  # opening a port throws away what came before
        port.write(first)
        wait_until(lambda: receiver.status.received_bytes == len(first))
        snapshot, _ = engine.step(receiver.take())
        assert snapshot.losses.lost_frames == 0
        port.pull()
        wait_until(lambda: receiver.status.disconnects == 1)
        assert not receiver.status.is_open
        port.plug_in()
        wait_until(lambda: receiver.status.is_open)
        port.write(second)
        wait_until(lambda: receiver.status.received_bytes == len(first) + len(second))
        snapshot, _ = engine.step(receiver.take())
    assert 30 < snapshot.losses.lost_frames < 60  # 10,000 bytes of frames of some 230
    assert snapshot.rates["imu"] > 0.0


def test_a_sender_ten_times_too_fast_is_shown_without_falling_behind(port: Port, drive) -> None:
    def send() -> None:
        for at in range(0, 180_000, 900):  # 45,000 bytes a second
            port.write(drive.stream[at : at + 900])
            time.sleep(0.02)

    shown, sender = Shown(), threading.Thread(target=send)
    with Receiver(SerialSource(str(port.link))) as receiver:
        wait_until(lambda: receiver.status.is_open)
        sender.start()
        last = run(receiver, Engine(LocalNavigator(NoWorker())), shown, None, lambda: not sender.is_alive())
        sender.join()
    assert last.t > 30.0
    delays = sorted(shown.delays)
    assert delays[len(delays) // 2] < 0.2  # s; a frame and a step, on a machine that others use
    assert delays[-1] < 2.0


class NoWorker(Foreground):
    """Nothing slow: what the line itself costs."""

    def identify(self, window: object) -> object:  # type: ignore[override]
        from concurrent.futures import Future

        future: Future[str] = Future()
        future.set_result("not here")
        return future


def test_bytes_that_are_not_taken_are_dropped_and_counted(port: Port) -> None:
    total = 3 * MOST_WAITING
    with Receiver(SerialSource(str(port.link))) as receiver:
        wait_until(lambda: receiver.status.is_open)  # opening a port throws away what came before
        port.write(bytes(total))
        wait_until(lambda: receiver.status.received_bytes == total)
        kept = sum(len(chunk.data) for chunk in receiver.take())
        assert kept <= MOST_WAITING
        assert receiver.status.dropped_bytes == total - kept


def test_a_file_is_read_no_farther_ahead_than_two_seconds(tmp_path: Path, drive) -> None:
    path = tmp_path / "capture.bin"
    path.write_bytes(drive.stream[:200_000])
    with Receiver(ReplaySource(path, speed=float("inf")), waits=True) as receiver:
        count = 0
        while not receiver.status.is_over or receiver.has_chunks:
            taken = sum(len(chunk.data) for chunk in receiver.take(0.02))
            assert taken <= READ_AHEAD + READ_BYTES
            count += taken
            time.sleep(0.01)
    assert count == 200_000


def test_a_port_that_is_not_there_is_waited_for(tmp_path: Path) -> None:
    with Receiver(SerialSource(str(tmp_path / "nothing"))) as receiver:
        wait_until(lambda: receiver.status.error != "")
        assert not receiver.status.is_open
        assert receiver.take() == []


def test_a_recording_is_played_at_the_chosen_speed(tmp_path: Path, drive) -> None:
    path = tmp_path / "capture.bin"
    path.write_bytes(drive.stream[:45_000])
    source = ReplaySource(path, speed=20.0)
    source.open()
    began, count = time.monotonic(), 0
    while (piece := source.read()) is not None:
        count += len(piece)
    assert count == 45_000
    assert 0.35 < time.monotonic() - began < 5.0  # ten seconds of stream


def test_a_pipe_ends_when_the_other_side_closes() -> None:
    reading, writing = os.pipe()
    with Receiver(PipeSource(reading), waits=True) as receiver:
        os.write(writing, b"abc")
        os.close(writing)
        wait_until(lambda: receiver.status.is_over)
        assert [chunk.data for chunk in receiver.take()] == [b"abc"]
    os.close(reading)


def test_a_port_may_be_an_address_that_pyserial_knows() -> None:
    source = source_for("loop://")
    assert isinstance(source, SerialSource)
    source.open()
    assert source._serial is not None
    source._serial.write(b"abc")
    assert source.read() == b"abc"
    source.close()


def test_what_is_wrong_with_a_source_ends_the_loop_instead_of_leaving_it_waiting(tmp_path: Path) -> None:
    class Broken(ReplaySource):
        def open(self) -> None: ...

        def read(self) -> bytes | None:
            raise ZeroDivisionError("a mistake")

    with Receiver(Broken(tmp_path)) as receiver, pytest.raises(ZeroDivisionError, match="a mistake"):
        run(receiver, Engine(LocalNavigator(Foreground())), Shown(), stop=stopped_after(5.0))


def stopped_after(seconds: float) -> Callable[[], bool]:
    end = time.monotonic() + seconds
    return lambda: time.monotonic() > end


def test_a_folder_and_a_name_that_is_nothing_are_refused(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="folder"):
        source_for(str(tmp_path))
    with pytest.raises(UsageError, match="no such port or file"):
        source_for(str(tmp_path / "monday.klg"))
    assert isinstance(source_for("/dev/ttyUSB17"), SerialSource)


def test_a_file_without_records_is_one_line_of_error(tmp_path: Path) -> None:
    path = tmp_path / "letters.bin"
    path.write_bytes(b"dear mechanic" * 100)
    with Receiver(ReplaySource(path)) as receiver:
        time.sleep(0.1)
        with pytest.raises(UsageError, match="neither blocks nor frames"):
            run(receiver, Engine(LocalNavigator(Foreground())), Shown())


def test_chunks_know_that_the_cable_was_pulled_before_them(port: Port) -> None:
    with Receiver(SerialSource(str(port.link))) as receiver:
        wait_until(lambda: receiver.status.is_open)  # opening a port throws away what came before
        port.write(b"a")
        wait_until(lambda: receiver.status.received_bytes == 1)
        port.pull()
        wait_until(lambda: receiver.status.disconnects == 1)
        port.plug_in()
        wait_until(lambda: receiver.status.is_open)
        port.write(b"b")
        wait_until(lambda: receiver.status.received_bytes == 2)
        chunks = receiver.take()
    assert [(c.data, c.after_break) for c in chunks] == [(b"a", False), (b"b", True)]
    assert isinstance(chunks[0], Chunk)
