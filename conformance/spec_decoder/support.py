"""What SPEC.md's blocks use without defining it: SHA-256, strings as bytes and the file of the tables."""

import hashlib
from collections import deque
from pathlib import Path

TABLES_SHA256 = "b8b489ae1faadaa4b3c91467cd7517a68c3ac7cda6ee1c5a2c8282dd3ec087b5"
DATA = Path(__file__).resolve().parents[2] / "refcodec" / "data"
TABLES = DATA / "tables-0.bin"

# The last inputs of SHA256. After DECODE_FILE the last ones are the parts, and what the scene's digest is made of.
HASHED: deque[bytes] = deque(maxlen=9)


# SPEC 2.4
def ascii_bytes(letters: str) -> list[int]:
    """Returns the bytes of a string (ASCII of 2.4)."""
    return list(letters.encode("ascii"))


# SPEC 2.4
def sha256(content: list[int]) -> list[int]:
    """Returns the SHA-256 of bytes, as bytes (SHA256 of 2.4), and keeps the input in HASHED."""
    data = bytes(content)
    HASHED.append(data)
    return list(hashlib.sha256(data).digest())


# SPEC Annex A
def table_bytes() -> list[int]:
    """Returns the bytes of the file of the tables. Raises RuntimeError if they are not those of version 0."""
    data = TABLES.read_bytes()
    if hashlib.sha256(data).hexdigest() != TABLES_SHA256:
        raise RuntimeError(f"{TABLES} is not the table file of version 0: restore it from the repository")
    return list(data)
