"""Reading recordings: bytes and rows in, RawSession out. Parsing only; estimates nothing."""
