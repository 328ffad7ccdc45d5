"""Untrusted JSON and text: every input gives a value or one error, and shown text cannot control a terminal."""

import contextlib
import json
import unicodedata
from pathlib import Path

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from refcodec.files.documents import DEPTH_MAX, DIGITS_MAX, DocumentError, parse_json, read_json
from refcodec.files.text import printable

VALUES = st.recursive(
    st.none() | st.booleans() | st.integers(-(10**30), 10**30) | st.floats(allow_nan=False, allow_infinity=False)
    | st.text(),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(), inner, max_size=4),
)  # fmt: skip


@given(VALUES)
def test_json_comes_back(value: object) -> None:
    assert parse_json(json.dumps(value)) == value
    assert parse_json(json.dumps(value, ensure_ascii=True).encode()) == value


@given(st.binary(max_size=64) | st.text('[]{}",:\\0e', max_size=64).map(str.encode))
@example(b'{"a": 1e999}')
@example(b'["\\')
def test_anything_is_a_value_or_one_error(data: bytes) -> None:
    with contextlib.suppress(DocumentError):
        parse_json(data)


@pytest.mark.parametrize(
    ("data", "text"),
    [
        (b"\xff{}", "not UTF-8"),
        (b"[" * (DEPTH_MAX + 1) + b"]" * (DEPTH_MAX + 1), "nested deeper"),
        (b"[" * 10**6, "nested deeper"),
        (b'{"a": 1, "a": 1}', "twice"),
        (b"Infinity", "a number is inf"),
        (b"[NaN]", "a number is nan"),
        (b"-1e400", "a number is -inf"),
        (b"1" * (DIGITS_MAX + 1), "digits"),
        (b"1" * 10**6, "digits"),
        (b"{", "not JSON"),
        (b"", "not JSON"),
        (b" " * 101, "more than 100 bytes"),
    ],
)
def test_what_is_refused(data: bytes, text: str) -> None:
    with pytest.raises(DocumentError, match=text):
        parse_json(data, 100 if data.isspace() else 1 << 30)


def test_brackets_in_strings_do_not_count() -> None:
    value = ["[" * 1000 + '"\\' + "{" * 1000]
    assert parse_json(json.dumps(value)) == value


def test_an_endless_file_is_not_read(tmp_path: Path) -> None:
    (tmp_path / "long").write_bytes(b" " * 1000)
    with pytest.raises(DocumentError, match="more than 10 bytes"):
        read_json(tmp_path / "long", 10)
    (tmp_path / "right").write_bytes(b" [1]")
    assert read_json(tmp_path / "right", 10) == [1]


@given(st.text(), st.none() | st.integers(0, 20), st.booleans())
@example("\x1b]0;title\x07\x9b31m", None, False)
@example("\u202egnp.exe\ud800", None, True)
def test_what_is_shown_steers_nothing(text: str, most: int | None, lines: bool) -> None:
    shown = printable(text, most, lines)
    for c in shown:
        assert c.isprintable() or (lines and c in "\n\t")
        assert unicodedata.category(c) not in ("Cc", "Cf", "Cs") or c in "\n\t"
    shown.encode("utf-8")
    if most is not None:
        assert len(shown) <= most + 40
    if text.isprintable() and most is None:
        assert shown == text
