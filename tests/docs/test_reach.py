"""The vectors of each line of SPEC.md's blocks, on the pages of SPEC.md."""

from __future__ import annotations

import importlib.util
import json
import re
from pathlib import Path

import pytest

if any(importlib.util.find_spec(name) is None for name in ("sphinx", "docutils")):
    pytest.skip("the extra `docs` is not installed", allow_module_level=True)

from docs import reach
from refcodec.inspect import specification


def test_each_block_has_its_lines(record: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Each line of the record is a line of one block, and no number is beside a comment or an empty line."""
    monkeypatch.setenv("C3GS_COVERAGE", str(record))
    found = reach.by_block.__wrapped__()
    blocks = re.findall(r"^```python\n(.*?)\n```$", specification.text(), re.DOTALL | re.MULTILINE)
    assert list(found) == blocks
    entries = [entry for block in found.values() for entry in block if entry is not None]
    assert len(entries) == len(json.loads(record.read_text(encoding="utf-8"))["lines"])
    for block, lines in found.items():
        for text, entry in zip(block.splitlines(), lines, strict=True):
            assert entry is None or (text.strip() and text.strip()[0] not in "#\"'")
    rounded = next(lines for block, lines in found.items() if block.startswith("def RSHIFT_ROUND"))
    assert [entry is None for entry in rounded[:3]] == [True, True, False]
    # A record of another suite is not shown, and none need be there.
    for text in (record.read_text(encoding="utf-8").replace('"manifest": "', '"manifest": "x'), None):
        monkeypatch.setenv("C3GS_COVERAGE", str(tmp_path / "other.json"))
        if text is not None:
            (tmp_path / "other.json").write_text(text, encoding="utf-8")
        assert not any(entry for block in reach.by_block.__wrapped__().values() for entry in block)


def test_a_block() -> None:
    own: list[reach.Reach] = [(3, ("x", "y")), None, (1, ("z",)), "why <not>", (9, ())]
    page = reach.html("a\n  b\nc\nd\ne", "<i>a</i>\n  b\nc\nd\ne", own)
    code, _, table = page.partition("<details")
    assert re.findall(r'data-count="(\w*)"', code) == ["3", "", "1", "argued", "9"]
    # The numbers are no part of the text.
    assert re.sub(r"<[^>]+>", "", code).strip() == "a\n  b\nc\nd\ne"
    assert 'title="3 vectors, such as x"' in code
    assert 'title="argued: why &lt;not&gt;"' in code
    assert "<summary>" in table
    rows = [re.findall(r"<td>(.*?)</td>", row) for row in re.findall(r"<tr>.*?</tr>", table)]
    assert rows == [
        ["<pre>a</pre>", "3 vectors", "x, y and others"],
        ["<pre>c</pre>", "1 vector", "z"],
        ["<pre>d</pre>", "argued: why &lt;not&gt;", ""],
        ["<pre>e</pre>", "9 vectors: every decoder runs it at its start", ""],
    ]
    assert "<details" not in reach.html("a", "a", [None])
