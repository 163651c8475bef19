"""Frames of the live stream: found between text, whatever the pieces in which they arrive."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from smoother.session.log_format import FRAME_CAPACITY
from smoother.session.log_frames import decode_frames, encode_frames, find_frames, lost_frames


@pytest.fixture(scope="module")
def records(make_records):
    return make_records(duration=1.0)


@pytest.fixture(scope="module")
def stream(records):
    return encode_frames(records, first_number=65530)


def received(pieces):
    """All frames, when bytes arrive in pieces."""
    frames, rest = [], b""
    for piece in pieces:
        found, done = find_frames(rest + piece)
        frames += found
        rest = (rest + piece)[done:]
    return frames, rest


def test_records_come_back_from_frames(records, stream, assert_same):
    frames, done = find_frames(stream)
    assert done == len(stream)
    assert_same(decode_frames(frames), records)
    assert [frame.number for frame in frames[:8]] == [65530, 65531, 65532, 65533, 65534, 65535, 0, 1]
    assert lost_frames(frames) == 0


@settings(max_examples=50, deadline=None)
@given(size=st.integers(1, 700))
def test_pieces_of_any_size_give_the_same_frames(stream, size):
    frames, rest = received([stream[i : i + size] for i in range(0, len(stream), size)])
    assert frames == find_frames(stream)[0]
    assert rest == b""


def test_text_between_frames_is_passed_over(stream):
    frames, _ = find_frames(stream)
    pieces, at = [b"boot 7\r\n"], 0
    for frame in frames:
        end = at + 11 + len(frame.records) + 4
        pieces += [stream[at:end], b"debug: 12 blocks\r\n"]
        at = end
    assert received(pieces) == (frames, b"")


@settings(max_examples=100, deadline=None)
@given(bits=st.lists(st.integers(0, 10**6), min_size=1, max_size=8))
def test_a_flipped_bit_loses_one_frame_and_is_noticed(stream, bits):
    damaged = np.frombuffer(stream, dtype=np.uint8).copy()
    for bit in bits:
        damaged[bit // 8 % len(damaged)] ^= 1 << bit % 8
    frames, _ = find_frames(damaged.tobytes())
    whole = find_frames(stream)[0]
    assert all(frame in whole for frame in frames)
    assert len(whole) - len(frames) <= len(set(bits)) + 1  # a damaged length at the end may hide the last frame too


@settings(max_examples=200, deadline=None)
@given(data=st.binary(max_size=600))
def test_no_bytes_make_the_reader_raise(data):
    frames, done = find_frames(b"\xa5\x5a" + data)
    assert 0 <= done <= len(data) + 2
    decode_frames(frames)


def test_lost_frames_are_counted_over_the_wrap(stream):
    frames, _ = find_frames(stream)
    assert lost_frames(frames[:3] + frames[8:]) == 5
    assert lost_frames([]) == 0


def test_a_cut_frame_waits_for_its_rest(stream):
    for size in range(1, 2 * FRAME_CAPACITY):
        _, done = find_frames(stream[:size])
        assert find_frames(stream[done:])[0] == [
            f for f in find_frames(stream)[0] if f not in find_frames(stream[:done])[0]
        ]
