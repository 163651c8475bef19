"""What is lost on the line is counted, and nothing else is."""

import numpy as np
import pytest

from smoother.live.decoding import Decoder
from smoother.live.receiver import Chunk
from smoother.session.log_format import FRAME_HEAD
from smoother.session.log_frames import find_frames


def frames_of(stream: bytes) -> list[bytes]:
    """The bytes of every frame."""
    parts, at = [], 0
    while at < len(stream):
        size = FRAME_HEAD.size + stream[at + 2] + 4
        parts.append(stream[at : at + size])
        at += size
    return parts


@pytest.fixture(scope="module")
def frames(drive) -> list[bytes]:
    return frames_of(drive.stream[:60_000])[:-1]


def decoded(pieces: list[Chunk]) -> tuple[Decoder, int]:
    decoder = Decoder()
    count = sum(len(batch.records.imu_t) for piece in pieces for batch in decoder.feed([piece]))
    return decoder, count


def test_a_clean_stream_in_pieces_of_any_size_loses_nothing(frames: list[bytes]) -> None:
    stream = b"".join(frames)
    rng = np.random.default_rng(1)
    cuts = np.sort(rng.integers(0, len(stream), 400))
    pieces = [Chunk(0.0, bytes(p)) for p in np.split(np.frombuffer(stream, np.uint8), cuts)]
    decoder, count = decoded(pieces)
    whole, expected = decoded([Chunk(0.0, stream)])
    assert count == expected > 1000
    assert decoder.losses == whole.losses
    assert (decoder.losses.frames, decoder.losses.lost_frames) == (len(frames), 0)
    assert (decoder.losses.noise_bytes, decoder.losses.damaged) == (0, 0)


def test_frames_left_out_are_counted_by_their_numbers(frames: list[bytes]) -> None:
    decoder, _ = decoded([Chunk(0.0, b"".join(frames[:10] + frames[17:40]))])
    assert decoder.losses.lost_frames == 7


def test_a_damaged_frame_is_lost_alone_and_counted_as_damaged(frames: list[bytes]) -> None:
    damaged = bytearray(frames[20])
    damaged[40] ^= 0x10
    decoder, _ = decoded([Chunk(0.0, b"".join([*frames[:20], bytes(damaged), *frames[21:40]]))])
    assert decoder.losses.frames == 39
    assert decoder.losses.lost_frames == 1
    assert decoder.losses.damaged >= 1
    assert decoder.losses.noise_bytes == len(damaged)


def test_noise_and_text_between_frames_change_no_record(frames: list[bytes]) -> None:
    rng = np.random.default_rng(2)
    noisy = [part for frame in frames for part in (frame, rng.bytes(rng.integers(0, 90)), b"boot 7\n")]
    decoder, count = decoded([Chunk(0.0, b"".join(noisy)), Chunk(0.1, frames[-1])])
    _, expected = decoded([Chunk(0.0, b"".join(frames))])
    # random bytes may look like the head of a frame and hide what follows only until its CRC is seen to be wrong
    assert decoder.losses.lost_frames == 0
    assert count == expected + len(find_frames(frames[-1])[0]) * 0 + decoded([Chunk(0.0, frames[-1])])[1]
    assert decoder.losses.noise_bytes > 10 * len(frames)


def test_a_restart_of_the_logger_begins_a_new_run_and_loses_no_frames(frames: list[bytes]) -> None:
    decoder = Decoder()
    batches = decoder.feed([Chunk(0.0, b"".join(frames[50:]))]) + decoder.feed([Chunk(1.0, b"".join(frames[:50]))])
    assert [batch.restarted for batch in batches] == [False, True]
    assert decoder.losses.restarts == 1
    assert decoder.losses.lost_frames == 0


def test_half_a_frame_before_a_pulled_cable_spoils_nothing_after_it(frames: list[bytes]) -> None:
    chunks = [Chunk(0.0, frames[0] + frames[1][:30]), Chunk(1.0, b"".join(frames[4:9]), after_break=True)]
    decoder = Decoder()
    decoder.feed(chunks)
    assert decoder.losses.frames == 6
    assert decoder.losses.lost_frames == 3
    assert decoder.losses.noise_bytes == 30
