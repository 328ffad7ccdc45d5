"""KHR_gaussian_splatting_compression_c3gs: files of export, the plugin for three.js, the validator, the schema."""

import json
import re
import shutil
import struct
import subprocess
from collections.abc import Callable
from pathlib import Path
from typing import Any

import jsonschema
import numpy as np
import pytest
from referencing import Registry
from referencing.jsonschema import DRAFT202012
from test_web_three import THREE, installed
from web_program import MISSING, NODE, ROOT

from refcodec.cli.main import main
from refcodec.folder.layout import SceneFolderError
from refcodec.formats.glb import COMPRESSION, EXTENSION
from refcodec.formats.table import read_splats

FILE = ROOT / "vectors" / "valid" / "static-degree-2.c3gs"
SPECIFICATION = ROOT / "spec" / "gltf" / COMPRESSION
# What the schema uses of those of glTF 2.0 itself.
GLTF = [
    (name, DRAFT202012.create_resource(schema))
    for name, schema in (
        ("glTFid.schema.json", {"type": "integer", "minimum": 0}),
        ("glTFProperty.schema.json", {"type": "object", "properties": {"extensions": {"type": "object"}}}),
    )
]
VALIDATE = """
const validator = require("gltf-validator"), fs = require("fs");
validator.validateBytes(new Uint8Array(fs.readFileSync(process.argv[1])))
  .then((report) => console.log(JSON.stringify(report.issues)));
"""

pytestmark = pytest.mark.no_cover


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the scene in both forms, and a damaged one."""
    folder = tmp_path_factory.mktemp("gltf")
    for form in ("c3gs", "both", "plain"):
        assert main(["export", str(FILE), "-o", str(folder / f"{form}.glb"), "--glb", form]) == 0
    data = bytearray((folder / "c3gs.glb").read_bytes())
    data[data.index(FILE.read_bytes()[:8]) + 100] ^= 1
    (folder / "damaged.glb").write_bytes(data)
    return folder


def parts(file: Path) -> tuple[dict[str, Any], bytes]:
    """Returns the JSON of a GLB file, and the bytes of its buffer."""
    data = file.read_bytes()
    (length,) = struct.unpack_from("<I", data, 12)
    return json.loads(data[20 : 20 + length]), data[28 + length :]


def write_changed(source: Path, target: Path, change: Callable[[dict[str, Any], dict[str, Any]], Any]) -> Path:
    """Writes a GLB file with changed JSON. change: gets all of it, and the primitive."""
    json_part, buffer = parts(source)
    change(json_part, json_part["meshes"][0]["primitives"][0])
    text = json.dumps(json_part).encode()
    text += b" " * (-len(text) % 4)
    head = struct.pack("<4sIII4s", b"glTF", 2, 28 + len(text) + len(buffer), len(text), b"JSON")
    target.write_bytes(head + text + struct.pack("<I4s", len(buffer), b"BIN\0") + buffer)
    return target


def columns(file: Path) -> dict[str, np.ndarray]:
    """Returns the attributes of a GLB file with plain Gaussians, by the names of three.js."""
    json_part, buffer = parts(file)
    named = {}
    for name, number in json_part["meshes"][0]["primitives"][0]["attributes"].items():
        view = json_part["bufferViews"][json_part["accessors"][number]["bufferView"]]
        own = buffer[view["byteOffset"] : view["byteOffset"] + view["byteLength"]]
        named[{"POSITION": "position", "COLOR_0": "color"}.get(name, name.lower())] = own
    return {name: np.frombuffer(own, np.float32) for name, own in named.items() if name != "color"}


@pytest.mark.parametrize("form", ["c3gs", "both"])
def test_the_scene_comes_out_again(files: Path, tmp_path: Path, form: str) -> None:
    assert main(["export", str(files / f"{form}.glb"), "-o", str(tmp_path / "again.c3gs")]) == 0
    assert (tmp_path / "again.c3gs").read_bytes() == FILE.read_bytes()


def test_other_files_are_refused(files: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    other = str(ROOT / "vectors" / "valid" / "trained-caliterra.c3gs")
    (tmp_path / "short.glb").write_bytes((files / "c3gs.glb").read_bytes()[:40])
    for source, output, reason in (
        (other, "a.glb", "depend on the view"),
        (str(files / "plain.glb"), "a.c3gs", "0 scenes with"),
        (str(tmp_path / "short.glb"), "a.c3gs", "it is cut"),
        (str(files / "c3gs.glb"), "a.ply", "must be one .c3gs file"),
    ):
        assert main(["export", source, "-o", str(tmp_path / output), "--glb", "c3gs"]) == 64
        assert reason in capsys.readouterr().err
        assert not (tmp_path / output).exists()


def view(**changes: Any) -> Callable[..., Any]:
    """A change of the buffer view of the scene."""
    return lambda root, _: root["bufferViews"][0].update(changes)


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        (view(byteOffset=-4), "byteOffset in its chunk JSON is -4: an integer >= 0"),
        (view(byteLength=1 << 60), "byteLength in its chunk JSON is 1152921504606846976: an integer <="),
        (view(byteLength=-1), "byteLength in its chunk JSON is -1: an integer >= 0"),
        (view(byteLength=1 << 20), "outside the binary chunk"),
        (view(byteOffset=0.5), "byteOffset in its chunk JSON is 0.5: an integer"),
        (view(byteOffset=4, byteLength=96), "is not a C3GS file"),
        (view(buffer=1), "in another file"),
        (lambda root, _: root["buffers"][0].update(uri="a.bin"), "in another file"),
        (lambda root, _: root.update(bufferViews={}), "has no bufferViews/0/byteLength"),
        (
            lambda _, own: own["extensions"][EXTENSION]["extensions"][COMPRESSION].update(bufferView=True),
            "bufferView in",
        ),
        (lambda root, _: root["meshes"].append({"primitives": [{"extensions": [0]}, 1]}), None),
        (lambda root, own: root["meshes"].append({"primitives": [own, own]}), None),
        (lambda root, _: root.update(meshes=0), "meshes in its chunk JSON is 0: a list"),
    ],
)
def test_other_json(
    change: Callable[..., Any], reason: str | None, files: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Values of JSON that are not as they should be. reason: None where they do not matter."""
    source = write_changed(files / "c3gs.glb", tmp_path / "a.glb", change)
    assert main(["export", str(source), "-o", str(tmp_path / "a.c3gs")]) == (64 if reason else 0)
    assert (reason or "") in capsys.readouterr().err


def test_converters_name_the_way_to_the_scene(files: Path) -> None:
    with pytest.raises(SceneFolderError, match="takes out"):
        read_splats(files / "c3gs.glb")


def test_readers_without_the_extension_see_the_fallback(files: Path) -> None:
    both, plain = (vars(read_splats(files / f"{form}.glb")) for form in ("both", "plain"))
    for name, values in plain.items():
        np.testing.assert_array_equal(both[name], values)


@pytest.mark.parametrize("form", ["c3gs", "both"])
def test_the_schema(files: Path, form: str) -> None:
    """The schema takes the files of export, and its example is in the text."""
    schema = json.loads((SPECIFICATION / "schema" / f"mesh.primitive.{COMPRESSION}.schema.json").read_text())
    json_part, _ = parts(files / f"{form}.glb")
    own = json_part["meshes"][0]["primitives"][0]["extensions"][EXTENSION]["extensions"][COMPRESSION]
    validator = jsonschema.Draft202012Validator(schema, registry=Registry().with_resources(GLTF))
    validator.check_schema(schema)
    validator.validate(own)
    for wrong in ({}, {"bufferView": -1}, {"bufferView": "0"}, [0]):
        assert not validator.is_valid(wrong)
    assert (COMPRESSION in json_part.get("extensionsRequired", [])) == (form == "c3gs")
    (example,) = re.findall(r"```json\n(.*?)```", (SPECIFICATION / "README.md").read_text(), re.DOTALL)
    shown = json.loads(example)["meshes"][0]["primitives"][0]
    assert shown["extensions"][EXTENSION]["extensions"][COMPRESSION] == own
    assert set(shown["attributes"]) <= set(json_part["meshes"][0]["primitives"][0]["attributes"])


@pytest.mark.skipif(NODE is None, reason=MISSING)
@pytest.mark.skipif(THREE is None, reason="three is in no folder of NODE_PATH, so its loader is not tested")
def test_the_plugin_for_three(files: Path, tmp_path: Path) -> None:
    """Compressed attributes are those of a plain file, bit by bit, but for exponentials of another library."""
    installed(tmp_path)
    shutil.copy(Path(__file__).with_name("gltf_web.mjs"), tmp_path)
    names = ["c3gs.glb", "both.glb", "damaged.glb"]
    for name in names:
        shutil.copy(files / name, tmp_path)
    changes: dict[str, tuple[Callable[..., Any], str]] = {
        "count.glb": (lambda root, _: root["accessors"][0].update(count=3), "has 3 VEC3"),
        "type.glb": (lambda root, _: root["accessors"][1].update(type="VEC3"), "VEC3, but"),
        "bytes.glb": (lambda root, _: root["accessors"][1].update(componentType=5121), "float numbers"),
        "missing.glb": (lambda _, own: own["attributes"].pop(f"{EXTENSION}:SH_DEGREE_1_COEF_0"), "must be in both"),
        "linear.glb": (lambda _, own: own["extensions"][EXTENSION].update(colorSpace="lin_rec709_display"), "not the"),
    }
    for name, (change, _) in changes.items():
        write_changed(files / "c3gs.glb", tmp_path / name, change)
    done = subprocess.run(
        [str(NODE), "gltf_web.mjs", *names, *changes], cwd=tmp_path, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    answer = json.loads(done.stdout)
    assert "SPEC.md" in answer["damaged.glb"]["error"]
    for name, (_, reason) in changes.items():
        assert reason in answer[name]["error"]
    wanted = columns(files / "plain.glb")
    for name in names[:2]:
        assert answer[name]["kind"] == "Points"
        texts = answer[name]["attributes"]
        assert set(texts) - {"color"} == set(wanted)
        for key, values in wanted.items():
            own = np.frombuffer(bytes.fromhex(texts[key]), np.float32)
            if key.endswith((":scale", ":rotation", ":opacity")):
                np.testing.assert_array_max_ulp(own, values, 1)
            else:
                assert own.tobytes() == values.tobytes()


@pytest.mark.skipif(NODE is None, reason=MISSING)
@pytest.mark.skipif(
    THREE is None or not (THREE / "gltf-validator").exists(), reason="gltf-validator is not beside three in NODE_PATH"
)
@pytest.mark.parametrize("form", ["c3gs", "both"])
def test_the_validator_of_khronos(files: Path, form: str) -> None:
    """It knows neither extension: it reports both, their attributes, and a buffer view that only they use."""
    assert THREE is not None
    words = [str(NODE), "-e", VALIDATE, str(files / f"{form}.glb")]
    done = subprocess.run(
        words, cwd=THREE.parent, env={"NODE_PATH": str(THREE)}, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    issues = {
        (m["code"], m["pointer"].rpartition("/")[2].partition(":")[0]) for m in json.loads(done.stdout)["messages"]
    }
    assert issues == {
        ("UNSUPPORTED_EXTENSION", "0"),
        ("UNSUPPORTED_EXTENSION", "1"),
        ("MESH_PRIMITIVE_INVALID_ATTRIBUTE", EXTENSION),
        ("UNUSED_OBJECT", "0"),
    }
