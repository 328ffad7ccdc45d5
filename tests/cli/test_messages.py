"""{commands} x {messages}: what a command says that is used wrongly, in one line, and with nothing changed."""

import inspect
import json
import re
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from cli_inputs import TRAINED, Call, contents, packages, rows

from refcodec import UsageError, api
from refcodec.api.command import sections, words
from refcodec.cli.parser import FORMER, GROUPS, make_parser

SPLAT = Path(__file__).resolve().parents[1] / "formats" / "foreign" / "playbot.ply"
# A command, and what it says. Its exit status is 64, and no file changes.
WRONG = rows(
    r"""
    nonsense | invalid choice
    --progress | unrecognized
    decode | required: FILE
    decode scene.c3gs | decode needs --output or --splat
    decode nowhere.c3gs -o new | nowhere.c3gs: No such file
    decode scene.c3gs -o photos | not a scene folder
    decode scene.c3gs -o scene.c3gs | scene.c3gs is the name of a file
    decode scene.c3gs -o scene.c3gs/x | ot a directory
    decode scene.c3gs -o new --chunks 2:1 | --chunks must be A:B with A below B, not 2:1
    decode scene.c3gs -o new --chunks 1:9 | scene.c3gs: there is no chunk 8
    decode scene.c3gs -o new --chunks 0:1 --keep-going | cannot be combined
    decode static.c3gs --splat scene.c3gs | allowed are .ply, .spz, .sog, .glb
    decode static.c3gs --splat a.ply -o folder | --splat is not allowed with --output
    decode static.c3gs --splat a.ply --keep-going | --splat writes whole files only
    decode trained.c3gs --splat a.ply | `refcodec export FILE -o OUTPUT` fits plain Gaussians to its views
    decode static-empty.c3gs --splat a.ply | it has no Gaussians
    decode static-far.c3gs --splat a.spz | SPZ positions are below 2^23
    encode photos -o out.c3gs | scene.json
    encode nowhere -o out.c3gs | there is no such folder
    encode scene.c3gs -o out.c3gs | is a file: give a scene folder
    encode model -o out.c3gs | refcodec convert
    encode scene -o scene | is a directory
    encode scene -o nowhere/out.c3gs | there is no directory
    encode scene -o out.c3gs --lambda 0.01 | is coded already: omit --lambda and --steps
    encode scene -o out.c3gs --lambda 2 | --lambda must be a number from 0.000001 to 1, not 2
    encode scene -o out.c3gs --max-work 1 | --max-work applies only to files
    encode scene -o out.c3gs --weights loose | --weights must be raw or packed, not loose
    encode scene -o out.c3gs --up z | --up must be +x or -x
    encode scene -o out.c3gs --meta Title=x | key
    encode scene -o out.c3gs --meta title | neither KEY=VALUE nor a file
    validate nowhere.c3gs | nowhere.c3gs: No such file
    validate . | it is a folder, not a C3GS file; encode a scene folder with refcodec encode
    validate scene.c3gs --max-anchors=-1 | --max-anchors must be a whole number of at least 0, not -1
    validate scene.c3gs --max-work 1.5 | --max-work must be a whole number of at least 0, not 1.5
    validate scene.c3gs --max-memory 1T | --max-memory must be a number of bytes such as 800M, not 1T
    validate scene.c3gs --max-memory= | --max-memory must be a number of bytes
    validate scene.c3gs --max-memory 999999999999999999999999999999 | --max-memory must be a number of bytes
    reconstruct scene.c3gs out --probes | --probes needs --trace TRACE
    inspect nowhere.c3gs --trace | nowhere.c3gs: No such file
    inspect scene.c3gs --hex --json | --json is not allowed with --hex
    inspect scene.c3gs --near 0 --anchor 0 | --anchor is not allowed with --near
    inspect scene.c3gs --anchor 6 | there is no anchor 6: the file has 6 anchors, from 0
    explain nonsense | nonsense
    render model -o images | refcodec convert | numba
    render scene.c3gs -o images --frames 0 | --frames must be a whole number from 1 to 100000, not 0
    eval model photos | refcodec convert | numba
    eval scene.c3gs photos --size wide | 400x300 | numba
    eval scene.c3gs photos --background grey | it is not white, black or R,G,B | numba
    export trained.c3gs -o scene.obj | allowed are .ply, .spz, .sog, .glb
    export trained.c3gs -o trained.c3gs | unknown suffix
    export trained.c3gs -o a.ply -o scene.obj | scene.obj has an unknown suffix
    export trained.c3gs -o a.ply -o a.ply | a.ply
    export trained.c3gs -o a.html -o b.html | a command writes one page
    export trained.c3gs -o nowhere/scene.ply | there is no directory
    export nothing.c3gs -o scene.ply | nothing.c3gs: No such file
    export trained.c3gs -o scene.ply --degree 4 | --degree must be a whole number from 0 to 3, not 4
    export trained.c3gs -o scene.ply --cameras nothing | nothing | numba
    export trained.c3gs -o scene.ply --photographs photos | --photographs applies only to .html outputs
    export trained.c3gs -o a.ply --glb c3gs | --glb c3gs is given, so the output must be one .glb file
    export trained.c3gs -o a.glb --glb c3gs | the scene is not static
    export static.c3gs -o a.glb --glb both --degree 1 | --degree applies only to made Gaussians
    export empty.c3gs -o scene.ply | no camera sees a Gaussian | numba
    export trained.c3gs -o scene.ply --spz-bits 6 | --spz-bits applies only to .spz outputs
    export trained.c3gs -o scene.spz --spz-bits 3 | --spz-bits must be a whole number from 4 to 8, not 3
    export static.c3gs -o scene.ply --degree 2 | a static scene, which needs no fit: omit --degree
    export trained.c3gs -o a.html --degree 2 | --degree applies only to splats
    export trained.c3gs -o a.ply --size 40 | --size applies only to photographs
    render scene.c3gs -o new --size 40 | --size applies only to photographs
    view scene.c3gs --size 40 | --size applies only to photographs
    view nowhere.c3gs | nowhere.c3gs: No such file
    view scene.c3gs --photographs nothing | nothing | PIL scipy
    view scene.c3gs --port 65536 | --port must be a whole number from 0 to 65535, not 65536
    train | train needs PHOTOGRAPHS and -o SCENE_DIR
    train photos -o new --preset slow | --preset must be fast or paper, not slow
    train photos -o new --voxel inf | --voxel must be a number above 0, not inf
    train photos -o new --seed 9223372036854775808 | --seed must be a whole number from 0 to 2^63 - 1
    train photos -o new --lambda 2 | --lambda must be a number from 0 to 1, not 2
    train photos -o new --lambda 0 --meta title=x | no metadata | torch numba
    train photos -o new --size 0x5 | size | torch numba
    train photos -o new --background grey | it is not white, black or R,G,B | torch numba
    train photos -o new --holdout=-1 | --holdout must be a whole number of at least 0, not -1
    train photos -o new --anchors 5 --voxel 1 | not allowed with
    train photos -o photos | not a scene folder | torch numba
    train photos -o new.c3gs | new.c3gs is the name of a file, but a scene folder is written | torch numba
    train photos -o new --from none | is not a scene folder | torch numba
    train photos -o new --from photos | cannot continue training | torch numba
    fit points3D.txt -o new --steps 0 | --steps must be a whole number of at least 1, not 0
    fit points3D.txt -o new --steps many | --steps must be a whole number of at least 1, not many
    fit points3D.txt -o new --lambda 0 | --lambda must be a number from 0.000001 to 1, not 0
    fit nowhere.txt -o new | nowhere.txt | torch
    fit nowhere.txt -o photos | not a scene folder | torch
    convert nowhere -o new | nowhere does not exist
    convert nowhere.ply -o new | nowhere.ply: the file does not exist | torch numba
    convert letter.txt -o new | neither a model folder nor a splat file
    convert splat.ply -o new --set steps=x | steps | torch numba
    convert splat.ply -o new --size 0 | size | torch numba
    convert splat.ply -o new --resume | nothing to resume | torch numba
    convert splat.ply -o new --cameras none.json | none.json | torch numba
    convert splat.ply -o new --pictures new/pictures | the same folder or nested | torch numba
    convert splat.ply -o new --pictures splat.ply | exists: choose another folder | torch numba
    convert sog -o new --views 6 | not JSON | torch numba
    convert photos/l -o new --views 3 | --views applies only to splat files
    convert photos/l -o new --lambda 0 | --lambda applies only to splat files
    convert nowhere.ply -o new --appearance 0 | --appearance applies only to model folders
    convert nowhere.ply -o new --fast | must end in .c3gs
    convert splat.ply -o new.c3gs | add --fast to code the splat
    convert nowhere.ply -o new --psnr 40 | --psnr applies only to --fast
    convert nowhere.ply -o new.c3gs --fast --seed 0 | --seed applies only to a training
    rd photos -o new --lambdas 0 0.1 | --lambdas must be a number above 0 and at most 1, not 0
    demo -o new --scene atlantis | --scene must be caliterra or snowmiku, not atlantis
    demo -o new --scene caliterra --photographs photos | --photographs is not allowed with --scene
    experiment letter.txt -o new --engine car | --engine must be local or ray, not car
    """,
    3,
)


@pytest.mark.parametrize(("command", "message", "needs"), WRONG)
def test_wrong_usage(command: str, message: str, needs: str, place: Path, call: Call) -> None:
    if not packages(*needs.split()):
        pytest.skip(f"needs {needs}")
    shutil.copy(TRAINED, "trained.c3gs")
    shutil.copy(TRAINED.with_name("static-degree-2.c3gs"), "static.c3gs")
    for name in ("empty.c3gs", "static-empty.c3gs", "static-far.c3gs"):
        shutil.copy(TRAINED.with_name(name), name)
    shutil.copy(SPLAT, "splat.ply")
    Path("model/point_cloud").mkdir(parents=True)
    Path("sog").mkdir()
    Path("sog/meta.json").write_text("{")
    before = contents(place)
    status, out, err = call(*command.split())
    lines = [line for line in err.splitlines() if line.startswith(("refcodec", "train: "))]
    assert (status, out, message in err) == (64, "", True), err
    assert len(lines) == 1 or command.startswith("export empty"), err
    assert '"code"' not in err
    assert "Traceback" not in err
    assert contents(place) == before


def test_no_command_lists_them(call: Call) -> None:
    status, out, err = call()
    assert (status, err) == (0, "")
    for names in GROUPS.values():
        assert all(re.search(rf"^  {name} +\w", out, re.MULTILINE) for name in names)
    assert call("--help")[:2] == (0, out)


def test_former_names_have_a_hint(call: Call) -> None:
    for former, new in FORMER.items():
        for word in (former, f"{former}=0.1"):
            status, _, err = call("rd", "photos", "-o", "x", word, "0.1")
            assert (status, err) == (64, f"refcodec: {former} is called {new} now\n")


def test_every_command_is_a_function_of_the_api() -> None:
    """Of the same words, of which each has a help text, and an example. All of them are listed."""
    parser = make_parser()
    (commands,) = (action.choices for action in parser._actions if isinstance(action.choices, dict))
    assert list(commands) == [name for names in GROUPS.values() for name in names]
    for module, names in api.COMMANDS.items():
        home = f"refcodec.api.{module}"
        made = {name for name, value in vars(sys.modules[home]).items() if hasattr(value, "command")}
        assert {name for name in made if getattr(sys.modules[home], name).__module__ == home} == set(names)
        for name in names:
            function = getattr(api, name)
            assert [word.name for word in words(function).values() if not word.text] == []
            stated = {action.dest for action in commands[function.command.name]._actions} - {"help"}
            assert stated == {word.name for word in words(function).values()}
            known = {*inspect.signature(function).parameters} - {"limits", "write", "stages"}
            assert known <= stated
            assert "    " + function.command.name in sections(function)["Examples"]


FIT, CONVERT = {"points": "p", "output": "o"}, {"source": "s", "output": "o"}


@pytest.mark.parametrize(
    ("function", "arguments", "message"),
    [
        (api.fit, {**FIT, "steps": 1.5}, "--steps must be a whole number of at least 1, not 1.5"),
        (api.fit, {**FIT, "steps": True}, "--steps must be a whole number of at least 1, not True"),
        (api.fit, {**FIT, "lambda_r": float("nan")}, "--lambda must be a number from 0.000001 to 1, not nan"),
        (api.train, {"from_scene": 3}, "--from must be a path, not 3"),
        (api.train, {"set": ["growth.most"]}, "is not NAME=VALUE"),
        (api.train, {"set": [3]}, "--set must be a text, not 3"),
        (api.train, {"device": "tpu"}, "--device must be cpu or cuda, not tpu"),
        (api.decode, {"file": b"", "keep_going": 1}, "--keep-going must be true or false, not 1"),
        (api.decode, {"file": b"", "chunks": range(3, 3)}, "--chunks must be A:B with A below B"),
        (api.digest, {"file": b"", "limits": 5}, "limits must be refcodec.Limits, not 5"),
        (api.convert, {**CONVERT, "psnr": 10}, "--psnr must be a number from 20 to 70, not 10"),
        (api.convert, {"source": "\0", "output": "o"}, "--source must be a path, not \0"),
        (api.digest, {"file": "a\0"}, "'a\\x00' is not a path: embedded null byte"),
        (api.render, {"file": "a", "output": "o", "frames": 10**30}, "--frames must be a whole number from 1 to"),
        (api.convert, {"source": "s", "output": None}, "--output must be a path, not None"),
        (api.convert, {**CONVERT, "source": ".", "up": np.zeros(2)}, "--up must be +x or -x"),
        (api.inspect, {"file": b"", "hex": True, "near": np.int64(3)}, "--near is not allowed with --hex"),
        (api.fit, {**FIT, "voxel": 10**400}, "--voxel must be a number above 0, not 1000"),
        (api.fit, {**FIT, "meta": [3]}, "metadata must be entries by key, or texts KEY=VALUE, not [3]"),
        (api.encode, {"scene": "s", "output": "o", "limits": 5}, "limits must be refcodec.Limits, not 5"),
    ],
)
def test_python_is_told_the_same(function: Any, arguments: dict[str, Any], message: str) -> None:
    with pytest.raises(UsageError, match=re.escape(message)):
        function(**arguments)
    with pytest.raises(TypeError, match="nonsense"):
        function(**arguments, nonsense=1)


@pytest.mark.parametrize(
    ("command", "package", "extra"),
    rows(
        """
        fit points3D.txt -o new | torch | fit
        train photos -o new | torch | train
        convert a.ply -o new | torch | convert
        render scene.c3gs -o new | numba | render
        eval scene.c3gs photos | numba | render
        export trained.c3gs -o b.ply | numba | render
        demo -o new | PIL | demo
        """,
        3,
    ),
)
def test_a_missing_package_is_named(command: str, package: str, extra: str, place: Path) -> None:
    shutil.copy(TRAINED, "trained.c3gs")
    Path("a.ply").write_bytes(b"ply\n")
    before = contents(place)
    program = f"import sys; sys.modules[{package!r}] = None; from refcodec.cli import main; sys.exit(main.main())"
    words = [sys.executable, "-c", program, *command.split()]
    done = subprocess.run(words, capture_output=True, text=True, check=False)
    message = f"refcodec: {command.split(maxsplit=1)[0]} needs {package}: pip install 'refcodec[{extra}]'\n"
    assert (done.returncode, done.stderr, contents(place)) == (64, message, before)


@pytest.mark.parametrize(
    ("data", "looks"),
    [
        (b"ply\nformat ascii 1.0\nend_header\n", "It looks like a PLY file: refcodec convert"),
        (b"\x1f\x8b" + bytes(30), "It looks like an SPZ file: refcodec convert"),
        (b"PK\3\4" + bytes(30), "It looks like a ZIP archive, such as a SOG file: refcodec convert"),
        (b"glTF" + bytes(30), "It looks like a .glb file: refcodec convert"),
        (b"# 3D point list with one line of data", "It looks like text: refcodec fit"),
        (bytes(40), "To see the spot"),
        (b"", "or a download or copy was cut short. To see the spot"),
    ],
)
def test_a_file_of_another_kind(data: bytes, looks: str, place: Path, call: Call) -> None:
    """inspect called a PLY file C3GS version 29793.25120. The verdict has the likely cause, as explain prints it."""
    Path("a").write_bytes(data)
    for command in ("validate", "inspect"):
        status, out, err = call(command, "a")
        assert (status, looks in err) == (1, True)
        assert json.loads(err.splitlines()[-1])["code"] == (102 if data else 101)
        assert ("not a C3GS file" in out) == (command == "inspect" and bool(data))
        assert len(out.splitlines()) <= 1 or not data
