"""What the release image sends over its serial line, on the emulated board, is what it writes to its card."""

import fcntl
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from live_here import Foreground, LocalNavigator
from smoother.live.engine import Engine
from smoother.live.receiver import Chunk
from smoother.session.log_format import LogRecords

FIRMWARE = Path(__file__).resolve().parents[2] / "firmware"
OUT = FIRMWARE.parent / "build"
RATE = 200  # samples a second over the line, of 1000 on the card


@pytest.fixture(scope="module")
def sent_and_recorded(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[bytes, LogRecords]]:
    """Bytes of the line, and records of the card, of a short drive."""
    sys.path.insert(0, str(FIRMWARE / "emulator"))
    import emulate
    import emulation

    OUT.mkdir(parents=True, exist_ok=True)
    with (OUT / "firmware.lock").open("w") as lock:  # one build for all processes of the run
        fcntl.flock(lock, fcntl.LOCK_EX)
        try:
            emulation.build_emulator()
            image = emulation.build_image()
        except emulation.build.MissingError as error:
            pytest.skip(f"needs system package gcc-arm-none-eabi, and unicorn and FatFs: {error}")
    records = emulate.drive_records(emulate.simulated(seed=5, duration=3.0))
    stimulus = emulation.stimulus_of(records)
    script = emulation.drive_script(stimulus, records)
    script.config += [f"stream={RATE}", "stream_baud=115200"]
    folder = tmp_path_factory.mktemp("streamed")
    emulation.run(folder, image, stimulus, script)
    yield (folder / "serial.txt").read_bytes(), emulate.recorded(folder)[0]


def test_the_live_view_takes_what_the_emulated_logger_sends(sent_and_recorded: tuple[bytes, LogRecords]) -> None:
    sent, card = sent_and_recorded
    engine = Engine(LocalNavigator(Foreground()))
    received = []
    for at in range(0, len(sent), 300):
        snapshot, batches = engine.step([Chunk(at * 1e-4, sent[at : at + 300])])
        received += [batch.records for batch in batches]
    assert snapshot.losses.lost_frames == snapshot.losses.restarts == snapshot.losses.damaged == 0
    assert 0 < snapshot.losses.noise_bytes < 2000  # the messages that a person reads
    assert snapshot.madgwick is not None
    t = np.concatenate([records.imu_t for records in received])
    counts = np.concatenate([records.imu for records in received])
    # every streamed sample that the card holds too is the same there, and a fifth of the card's were streamed
    both, on_line, on_card = np.intersect1d(t, card.imu_t, return_indices=True)
    assert len(both) == pytest.approx(len(card.imu_t) * RATE / 1000, abs=RATE * 0.1)
    np.testing.assert_array_equal(counts[on_line], card.imu[on_card])
    assert set(card.sentences) <= {sentence for records in received for sentence in records.sentences}
