"""Damage as it happens to files, and as someone would do it on purpose. Every mutator is bytes in, bytes out."""

import re
from collections.abc import Callable

import numpy as np

Mutator = Callable[[bytes, np.random.Generator], bytes]
NUMBERS = (
    *(b"0", b"-0", b"-1", b"1e308", b"-1e308", b"1e-320", b"nan", b"inf", b"-inf", b"NaN", b"", b" ", b"1e999"),
    *(b"4294967295", b"4294967296", b"9223372036854775808", b"0x1F", b"1_000", b"1,5", b"1" * 400, b"\xd9\xa1"),
    *(b"90", b"-90.0001", b"180", b"360", b"86400", b"1e10", b"1e9", b"100000", b"0.1", b"True", b"[]", b"{}"),
)
WORDS = (
    *(b"=HYPERLINK(1)", b"<script>alert(1)</script>", b"{{7*7}}", b"__import__('os').system('x')", b"${HOME}"),
    *(b"../../../etc/passwd", b"/etc/passwd", b"..", b"\x1b[2J", b"%n%s%n", b"\x00", b"\xff\xfe", b"\xef\xbb\xbf"),
    *(b"[", b"]", b"{", b"}", b'"', b"'", b"<", b">", b"&", b"<!DOCTYPE x [<!ENTITY a 'b'>]>&a;", b"\\", b"#", b"="),
    *(b"\n", b"\r", b"\r\n", b",", b";", b"\t", b"YY", b"$", b"*00", b"$GPRMC,", b"t_s,", b"[data]", b"</trkpt>"),
)
_NUMBER = re.compile(rb"[-+]?\d+(?:\.\d*)?(?:[eE][-+]?\d+)?")


def _place(data: bytes, rng: np.random.Generator) -> int:
    return int(rng.integers(len(data) + 1))


def _stretch(data: bytes, rng: np.random.Generator) -> slice:
    """A stretch of any size from a byte to a tenth of the file."""
    start = _place(data, rng)
    length = int(np.exp(rng.uniform(0.0, np.log(max(2.0, len(data) / 10)))))
    return slice(start, start + length)


def flip_bits(data: bytes, rng: np.random.Generator) -> bytes:
    damaged = bytearray(data)
    for _ in range(int(rng.integers(1, 30))):
        if damaged:
            damaged[int(rng.integers(len(damaged)))] ^= 1 << int(rng.integers(8))
    return bytes(damaged)


def cut(data: bytes, rng: np.random.Generator) -> bytes:
    return data[: _place(data, rng)]


def lose_start(data: bytes, rng: np.random.Generator) -> bytes:
    return data[_place(data, rng) :]


def lose_stretch(data: bytes, rng: np.random.Generator) -> bytes:
    gone = _stretch(data, rng)
    return data[: gone.start] + data[gone.stop :]


def repeat_stretch(data: bytes, rng: np.random.Generator) -> bytes:
    again, at = _stretch(data, rng), _place(data, rng)
    return data[:at] + data[again] * int(rng.integers(1, 4)) + data[at:]


def overwrite_noise(data: bytes, rng: np.random.Generator) -> bytes:
    bad = _stretch(data, rng)
    return data[: bad.start] + rng.bytes(len(data[bad])) + data[bad.stop :]


def overwrite_constant(data: bytes, rng: np.random.Generator) -> bytes:
    """A sector never written, or erased."""
    bad = _stretch(data, rng)
    return data[: bad.start] + bytes([int(rng.choice([0, 255, 10, 32, 65]))]) * len(data[bad]) + data[bad.stop :]


def insert_word(data: bytes, rng: np.random.Generator) -> bytes:
    for _ in range(int(rng.integers(1, 6))):
        at = _place(data, rng)
        data = data[:at] + WORDS[int(rng.integers(len(WORDS)))] + data[at:]
    return data


def replace_numbers(data: bytes, rng: np.random.Generator) -> bytes:
    found = list(_NUMBER.finditer(data))
    if not found:
        return insert_word(data, rng)
    for i in sorted(rng.integers(len(found), size=int(rng.integers(1, 6))).tolist(), reverse=True):
        data = data[: found[i].start()] + NUMBERS[int(rng.integers(len(NUMBERS)))] + data[found[i].end() :]
    return data


def shuffle_lines(data: bytes, rng: np.random.Generator) -> bytes:
    lines = data.split(b"\n")
    i, j = sorted(rng.integers(len(lines), size=2).tolist())
    part = lines[i:j]
    rng.shuffle(part)
    return b"\n".join([*lines[:i], *part, *lines[j:]])


def repeat_lines(data: bytes, rng: np.random.Generator) -> bytes:
    lines = data.split(b"\n")
    i = int(rng.integers(len(lines)))
    return b"\n".join([*lines[:i], *([lines[i]] * int(rng.integers(2, 50))), *lines[i:]])


def mend_line_ends(data: bytes, rng: np.random.Generator) -> bytes:
    end = (b"\r", b"\r\n", b"\n\n", b"")[int(rng.integers(4))]
    return data.replace(b"\r\n", b"\n").replace(b"\n", end)


def recode(data: bytes, rng: np.random.Generator) -> bytes:
    coding = ("utf-16", "utf-16-le", "utf-32", "utf-8-sig")[int(rng.integers(4))]
    return data.decode("latin-1").encode(coding)


def empty(data: bytes, rng: np.random.Generator) -> bytes:
    return b"" if rng.random() < 0.5 else bytes(int(rng.integers(1, 5000)))


MUTATORS: tuple[Mutator, ...] = (
    *(flip_bits, cut, lose_start, lose_stretch, repeat_stretch, overwrite_noise, overwrite_constant, insert_word),
    *(replace_numbers, replace_numbers, shuffle_lines, repeat_lines, mend_line_ends, recode, empty),
)


def mutate(files: dict[str, bytes], rng: np.random.Generator) -> tuple[dict[str, bytes], str]:
    """Damage one to three times; return the files and a word on what was done."""
    damaged, done = dict(files), []
    for _ in range(int(rng.integers(1, 4))):
        name = sorted(damaged)[int(rng.integers(len(damaged)))]
        mutator = MUTATORS[int(rng.integers(len(MUTATORS)))]
        damaged[name] = mutator(damaged[name], rng)
        done.append(f"{mutator.__name__} {name}")
    return damaged, ", ".join(done)
