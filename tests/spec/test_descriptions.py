"""spec/c3gs.ksy: Kaitai Struct reads the vectors as refcodec does. `python -m spec --check` compares it with SYNTAX.

The compiler is looked for in the folders of NODE_PATH: `npm install kaitai-struct-compiler js-yaml`. Its library at run
time is `pip install kaitaistruct`.
"""

from __future__ import annotations

import importlib.util
import os
import re
import shutil
import subprocess
from pathlib import Path
from typing import Any

import pytest

from refcodec.bitstream.syntax import SYNTAX, parse_elements, size_of
from spec import descriptions

ROOT = Path(__file__).resolve().parents[2]
FOLDERS = [Path(name) for name in os.environ.get("NODE_PATH", "").split(os.pathsep) if name]
FOLDER = next((f for f in FOLDERS if (f / "kaitai-struct-compiler").exists() and (f / "js-yaml").exists()), None)
COMPILE = """
const yaml = require("js-yaml"), compiler = require("kaitai-struct-compiler"), fs = require("fs");
compiler.compile("python", yaml.load(fs.readFileSync(process.argv[1], "utf8")), null, false).then(files => {
  for (const [name, text] of Object.entries(files)) fs.writeFileSync(name, text);
});
"""


def test_every_table_and_field_is_described() -> None:
    text = descriptions.kaitai()
    types = set(re.findall(r"^  (\w+):$", text, re.MULTILINE))
    for name, fields in SYNTAX.items():
        own = re.sub(r"(?<=[a-z])(?=[A-Z])", "_", name).lower()
        assert own in types
        body = re.search(rf"^  {own}:\n((?:    .*\n)+)", text, re.MULTILINE)
        assert body is not None
        found = re.findall(r"^      - id: (\w+)$", body[1].partition("    seq:\n")[2], re.MULTILINE)
        assert [f for f in found if f not in ("further", "items")] == [field for field, _ in fields]
    # Whatever a type is called, there is one.
    called = {name.partition("(")[0] for name in re.findall(r"^ +type: (\S+)$", text, re.MULTILINE)}
    assert called - types <= {"str", *descriptions._SCALARS.values()}


@pytest.mark.slow
@pytest.mark.skipif(
    FOLDER is None or shutil.which("node") is None, reason="kaitai-struct-compiler and js-yaml are not in NODE_PATH"
)
@pytest.mark.skipif(importlib.util.find_spec("kaitaistruct") is None, reason="kaitaistruct is not installed")
def test_kaitai_struct_reads_the_vectors(tmp_path: Path) -> None:
    """Every element of prologue and header has refcodec's value, and every valid file is read to its end."""
    subprocess.run(["node", "-e", COMPILE, ROOT / "spec" / "c3gs.ksy"], cwd=tmp_path, check=True)
    spec = importlib.util.spec_from_file_location("c3gs", tmp_path / "c3gs.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    # Those with a damaged ancillary section, which decoders ignore, are left out.
    paths = [p for p in sorted((ROOT / "vectors" / "valid").glob("*.c3gs")) if "-broken-" not in p.name]
    assert len(paths) > 300
    for path in paths:
        data = path.read_bytes()
        found = module.C3gs.from_bytes(data)
        assert found._io.pos() == len(data), path.name
        for name, start in (("Prologue", 0), ("Header", size_of("Prologue"))):
            for element in parse_elements(name, data, start):
                if element.kind == "padding" or element.path in ("signature", "header_crc"):
                    continue
                value = at(getattr(found, name.lower()), element.path)
                wanted = element.value.decode("latin-1") if element.path.endswith(".type") else element.value
                assert value == wanted, f"{path.name}: {element.path}"


def at(value: Any, path: str) -> Any:
    """What lies at a path such as directory[0].type."""
    for word in re.findall(r"\w+", path):
        value = value[int(word)] if word.isdigit() else getattr(value, word)
    return value
