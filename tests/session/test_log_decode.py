"""Blocks: what was written is read; damage costs the blocks it touches and nothing else."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from smoother.session.log_decode import Losses, decode, find_blocks
from smoother.session.log_encode import encode
from smoother.session.log_format import BLOCK_BYTES, CAPACITY, IMU, Gap, LogRecords

SESSION = 0xC0FFEE


@pytest.fixture(scope="module")
def records(make_records):
    return make_records(duration=1.5)


@pytest.fixture(scope="module")
def image(records):
    return encode(records, SESSION)


def samples_of_each_block(image):
    """Times of the IMU samples in each block, decoded alone."""
    blocks, _ = find_blocks(image)
    return [decode(blocks.select(np.array([i])))[0].imu_t.tolist() for i in range(len(blocks))]


def test_what_was_encoded_is_decoded(records, image, assert_same):
    blocks, damaged = find_blocks(image)
    have, losses = decode(blocks)
    assert_same(have, records)
    assert (damaged, losses) == (0, Losses())


@pytest.mark.parametrize("rate", [50, 100, 200, 333, 500, 1000])
def test_every_rate_comes_back(rate, make_records, assert_same):
    records = make_records(duration=2.0, rate=rate)
    assert_same(decode(find_blocks(encode(records, 1))[0])[0], records)


def test_an_empty_recording_has_no_blocks(assert_same):
    assert encode(LogRecords(), 1) == b""
    have, losses = decode(find_blocks(b"")[0])
    assert_same(have, LogRecords())
    assert losses == Losses()


def test_blocks_are_full_at_1_khz(make_records):
    records = make_records(duration=5.0, rate=1000)
    image = encode(records, 1)
    blocks, _ = find_blocks(image)
    assert np.mean(blocks.head["used"][:-1]) > 0.96 * CAPACITY  # what is left over is too small for the next record


def test_truncation_at_every_byte_loses_only_the_cut_block(image):
    per_block, expected, seen = samples_of_each_block(image), [], -1
    for size in range(len(image) + 1):
        blocks, _ = find_blocks(image[:size])
        assert len(blocks) == size // BLOCK_BYTES
        if len(blocks) > seen:
            seen = len(blocks)
            expected += per_block[seen - 1] if seen else []
            have, losses = decode(blocks)
            assert have.imu_t.tolist() == expected
            assert losses == Losses()
    assert seen == len(per_block)


@settings(max_examples=200, deadline=None)
@given(data=st.data())
def test_flipped_bits_lose_only_the_blocks_they_touch(image_once, data):
    image, per_block = image_once
    bits = data.draw(st.lists(st.integers(0, 8 * len(image) - 1), min_size=1, max_size=20, unique=True))
    damaged = np.frombuffer(image, dtype=np.uint8).copy()
    for bit in bits:
        damaged[bit // 8] ^= 1 << bit % 8
    touched = {bit // 8 // BLOCK_BYTES for bit in bits}
    blocks, _ = find_blocks(damaged.tobytes())
    have, losses = decode(blocks)
    assert have.imu_t.tolist() == [t for i, block in enumerate(per_block) if i not in touched for t in block]
    last = max(set(range(len(per_block))) - touched)
    inside = [i for i in touched if i < last]
    assert losses.blocks == len(inside)
    assert losses.samples == sum(len(per_block[i]) for i in inside)


@pytest.fixture(scope="module")
def image_once(image):
    return image, samples_of_each_block(image)


@settings(max_examples=200, deadline=None)
@given(data=st.binary(max_size=3000))
def test_no_bytes_make_the_reader_raise(data):
    decode(find_blocks(data)[0])
    decode(find_blocks(b"KLG\x01" + data)[0])


@settings(max_examples=200, deadline=None)
@given(content=st.binary(min_size=BLOCK_BYTES, max_size=BLOCK_BYTES), used=st.integers(0, CAPACITY))
def test_no_records_in_a_whole_block_make_the_reader_raise(content, used):
    """Magic, length and CRC are right, the rest is anything."""
    decode(find_blocks(sealed(content, used))[0])


def sealed(content, used):
    import zlib

    block = b"KLG\x01" + content[4:18] + used.to_bytes(2, "little") + content[20:508]
    return block + zlib.crc32(block).to_bytes(4, "little")


def test_blocks_are_found_wherever_they_begin(records, image, assert_same):
    shifted = b"x" * 77 + image[: 5 * BLOCK_BYTES] + b"KLG" + image[5 * BLOCK_BYTES :]
    assert_same(decode(find_blocks(shifted)[0])[0], records)


def test_blocks_out_of_order_and_twice_are_put_in_order(records, image, assert_same):
    pieces = [image[i : i + BLOCK_BYTES] for i in range(0, len(image), BLOCK_BYTES)]
    shuffled = b"".join([*pieces[3:], *pieces[:3], pieces[5]])
    have, losses = decode(find_blocks(shuffled)[0])
    assert_same(have, records)
    assert losses == Losses(duplicates=1)


def test_a_record_of_a_newer_version_costs_at_most_the_rest_of_its_block(image):
    whole, _ = find_blocks(image)
    before = decode(whole)[0]
    newer = bytearray(image[BLOCK_BYTES : 2 * BLOCK_BYTES])
    newer[24] = 0x7E  # a short type of which the length is not known
    block = sealed(bytes(newer), int.from_bytes(newer[18:20], "little"))
    have, losses = decode(find_blocks(image[:BLOCK_BYTES] + block + image[2 * BLOCK_BYTES :])[0])
    assert losses.unreadable == 1
    lost = set(before.imu_t.tolist()) - set(have.imu_t.tolist())
    assert lost == set(samples_of_each_block(image)[1])


def test_a_long_record_of_a_newer_version_is_stepped_over():
    record = bytes([0xC0, 3, 0, 0, 0, 0, 1, 2, 3]) + bytes([1, 5, 0]) + bytes(12)
    block = sealed(bytes(24) + record.ljust(488, b"\0"), len(record))
    have, losses = decode(find_blocks(block)[0])
    assert have.imu_t.tolist() == [5]
    assert losses.unreadable == 0


def test_lost_samples_in_gaps_are_no_missing_samples(records):
    gap = Gap(IMU, 1, 40, int(records.imu_t[100]), int(records.imu_t[139]))
    keep = np.r_[0:100, 140 : len(records.imu_t)]
    holed = replace(records, imu_t=records.imu_t[keep], imu=records.imu[keep], gaps=(gap,))
    have, losses = decode(find_blocks(encode(holed, 1))[0])
    assert losses == Losses()
    assert have.gaps == (gap,)


def test_times_before_power_on_are_refused(records):
    with pytest.raises(ValueError, match="before power-on"):
        encode(replace(records, imu_t=records.imu_t - 10_000_000), 1)
    with pytest.raises(ValueError, match="longer than 128"):
        encode(replace(records, sentences=((5, b"$" * 129),)), 1)


def test_hours_without_samples_between_events_come_back(records):
    events = (replace(records.events[0], t_us=5), replace(records.events[0], t_us=3 * 3600 * 10**6))
    have, _ = decode(find_blocks(encode(LogRecords(events=events), 1))[0])
    assert have.events == events
