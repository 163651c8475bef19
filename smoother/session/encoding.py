"""How the text of a file is encoded, where it is not in single bytes: Windows programs write UTF-16, with or without a
mark. Imports nothing of this project."""

WIDE_BYTES, FEWEST_WIDE = 256, 8  # looked at, and characters that tell


def wide_encoding(data: bytes) -> str | None:
    """How a text of two bytes a character is encoded, by its mark or by the zeros of Latin ones; None for others."""
    if data.startswith((b"\xff\xfe", b"\xfe\xff")):
        return "utf-16"
    even, odd = data[0:WIDE_BYTES:2], data[1:WIDE_BYTES:2]
    if len(odd) < FEWEST_WIDE or (0 in even) == (0 in odd):
        return None
    if not any(odd):
        return "utf-16-le"
    return "utf-16-be" if not any(even) else None


def in_utf8(data: bytes) -> bytes:
    """Return a text of two bytes a character, or the beginning of one, in UTF-8; others as they are."""
    encoding = wide_encoding(data)
    return data if encoding is None else data.decode(encoding, errors="replace").encode()
