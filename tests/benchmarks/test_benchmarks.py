"""The benchmarks, on small scenes: their tables are whole, and figures that have a right value are right."""

import re
from pathlib import Path

import numpy as np
import pytest
import torch

from benchmarks import converted, exports, results, worst
from benchmarks.__main__ import main
from benchmarks.large import TRAINED, large_file, made_static
from benchmarks.peers import __main__ as peers
from benchmarks.peers.speed import repeated
from benchmarks.peers.trainer import SplatSettings, SplatTrainer, change
from refcodec.bitstream.codec import emit, parse
from refcodec.bitstream.errors import BitstreamError
from refcodec.bitstream.positions import PACKED
from refcodec.encoder.positions import morton_order
from refcodec.experiments.cells import Evaluation, Measures
from refcodec.formats.harmonics import REST
from refcodec.formats.splats import Splats
from refcodec.formats.table import write_splats
from refcodec.photographs.photographs import read_photographs

ROOT = Path(__file__).resolve().parents[2]
CALITERRA = ROOT / "examples" / "photographs" / "caliterra"


def splats(count: int, degree: int) -> Splats:
    """A number of Gaussians in a ball."""
    random = np.random.default_rng(count + degree)
    shapes = {"mean": (3,), "base": (3,), "rest": (REST[degree], 3), "opacity": (), "scale": (3,), "quaternion": (4,)}
    arrays = {name: random.normal(size=(count, *shape)).astype(np.float32) for name, shape in shapes.items()}
    return Splats(**{**arrays, "rest": 0.3 * arrays["rest"], "scale": -2 + 0.3 * arrays["scale"]})


def test_the_table_of_the_front_page_is_that_of_the_results() -> None:
    """Of each scene, the row with the highest PSNR that SPZ and a scene of C3GS reach."""
    text, wanted = results.RESULTS.read_text(encoding="utf-8"), {}
    point = re.compile(r"^\| (\w+)(?:-800)? \| ([\d.]+) \| ([\d.]+) \| \S+ \| ([\d.]+) \|$", re.MULTILINE)
    for size in (200, 400, 800):
        for scene, psnr, spz, n in point.findall(text.split(f"<!-- peers-{size}: ")[1]):
            own = f"**{float(n):.0f} KB**, {float(spz) / float(n):.1f} times smaller | {float(spz):,.0f} KB"
            wanted[scene, size] = f"| {scene}, {size} pixels, {float(psnr):.1f} dB | {own} |"
    readme = (ROOT / "README.md").read_text(encoding="utf-8")
    assert len(wanted) == readme.count("times smaller |") == 6
    assert "\n".join(wanted.values()) in readme


@pytest.mark.slow
def test_decoders(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    """All decoders give one digest, and have a row; a section is written if it is asked for."""
    monkeypatch.setattr(results, "RESULTS", tmp_path / "RESULTS.md")
    assert main(["decode", "--anchors", "300", "--rounds", "1", "--kept", str(tmp_path), "--write"]) == 0
    assert "| refcodec, numpy, with the digest |" in capsys.readouterr().out
    text = (tmp_path / "RESULTS.md").read_text()
    assert "<!-- decode: begin -->\n## Decoding a large scene\n\n`python -m benchmarks decode --anchors 300 " in text


def test_large_scenes() -> None:
    """Each copy has the trained symbols and packed positions, also if the scene is made static."""
    trained = parse(TRAINED.read_bytes()).scene
    count, more, order = trained.anchor_count, 300, morton_order(trained.positions)
    for source in (trained, made_static(trained, 1)):
        data = large_file(source, 2 * count + more)
        scene = parse(data).scene
        assert emit(scene) == data
        for first, rows in ((0, order), (count, order), (2 * count, order[:more])):
            own = slice(first, first + len(rows))
            assert np.array_equal(scene.positions[own], trained.positions[rows])
            assert np.array_equal(scene.masks[own], trained.masks[rows])
            for kind in ("features", "scalings", "offsets"):
                assert np.array_equal(getattr(scene.attributes, kind)[own], getattr(trained.attributes, kind)[rows])
        assert set(scene.position_forms or ()) == {PACKED}
    copies = repeated(splats(50, 1), 120)
    # Copies differ in their places only.
    assert (len(np.unique(copies.scale, axis=0)), len(np.unique(copies.mean, axis=0))) == (50, 120)


def test_the_worst_files() -> None:
    """A decoder accepts or refuses them as their names say, within the memory of SPEC 13.1."""
    for name, data in worst.files(False).items():
        assert worst.memory_bound(worst.codec.parse_container(data), len(data)) < 80 << 20
        if name.endswith("valid"):
            parse(data)
        else:
            with pytest.raises(BitstreamError, match="CRC-32"):
                parse(data)


# --- peers ------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("most", [200, 201, 230, 1000])
def test_density_control_keeps_the_cap(most: int) -> None:
    """And there is room for all that it allows."""
    given = {name: torch.from_numpy(value) for name, value in vars(splats(200, 1)).items()}
    gradient = torch.rand(200, generator=torch.Generator().manual_seed(3)) + 1
    alive = int((torch.sigmoid(given["opacity"]) >= 0.005).sum())
    made = change(given, gradient, most, 1.0, False, torch.Generator().manual_seed(1))
    assert len(made.values("mean", given["mean"])) == min(most, 2 * alive)


def test_a_training_learns_within_its_cap(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("benchmarks.peers.trainer.PERIOD", 10)
    photographs = read_photographs(CALITERRA, 60)
    trainer, losses = SplatTrainer(photographs, SplatSettings(700, 60, "60", 0, 2)), list[float]()
    assert trainer.count == 350
    monkeypatch.setattr("benchmarks.peers.trainer.photometric", lambda *values: _kept(losses, *values))
    assert len(trainer.run()["mean"]) <= trainer.count == 700
    assert np.mean(losses[-10:]) < 0.7 * np.mean(losses[:10])


def _kept(losses: list[float], *values: object) -> torch.Tensor:
    from refcodec.train.losses import photometric  # noqa: PLC0415

    loss = photometric(*values)  # type: ignore[arg-type]
    losses.append(float(loss.detach()))
    return loss


@pytest.mark.slow
def test_peers(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    """3DGS is trained for a plan, once, and its cells are in one table and picture with those of an experiment."""
    plan = tmp_path / "plan.toml"
    text = f'lambdas = [0.01]\nseeds = [0]\nsteps = 3\n[[scenes]]\nname = "a"\nphotographs = "{CALITERRA}"\nsize = 40\n'
    plan.write_text(text + '[[methods]]\nname = "pro"\n')
    out = tmp_path / "out"
    monkeypatch.setattr(peers, "tool", lambda: Path("splat-transform"))
    shown = Evaluation(1000, 9, {}, Measures(30, 0.9, 30, 0.9), [])
    job = peers.job(out.absolute(), "a", CALITERRA, SplatSettings(200, 3, "40", 0))
    job.record.parent.mkdir(parents=True)
    step = job.steps[0]
    step.output.parent.mkdir()
    step.output.write_bytes(peers.dumped({"files": {"ply": shown, "spz": shown}, "seconds": 5.0}))
    entry = {"key": step.key(job.depends), "seconds": 1.0, "processor_seconds": 1.0, "done": True}
    job.record.write_bytes(peers.dumped({"train": entry}))
    (out / "experiment.json").write_text('{"format": "C3GS experiment"}')
    assert peers.main(["run", str(plan), "-o", str(out), "--caps", "200"]) == 0
    monkeypatch.setattr(results, "RESULTS", tmp_path / "RESULTS.md")
    monkeypatch.setattr(peers, "ROOT", tmp_path)
    assert peers.main(["table", str(out), "--seeds", "1", "--write"]) == 0
    assert "| a | 3DGS, SPZ | 200 | 1 | 1,000 | 30.00 | 0.9000 | 5 |" in capsys.readouterr().out
    assert set(re.findall(r"3DGS, \w+", (tmp_path / "docs/pictures/peers-40/a.svg").read_text())) == {"3DGS, SPZ"}
    # The training itself, without the program that writes SPZ and SOG.
    monkeypatch.setattr(peers, "FORMATS", ())
    made = peers.train(CALITERRA, tmp_path / "b", SplatSettings(200, 3, "40", 0))
    assert made["files"]["ply"].bytes == (tmp_path / "b" / "splat.ply").stat().st_size


def test_bytes_between_two_points() -> None:
    """Half way between 100 and 400 bytes on a logarithmic axis lies 200; outside of a curve nothing does."""
    curve = [(100.0, 30.0), (400.0, 32.0), (800.0, 33.0)]
    sizes = [peers.bytes_at(curve, psnr) for psnr in (29.9, 30, 31, 32, 33, 33.1)]
    assert sizes == [None, pytest.approx(100), pytest.approx(200), pytest.approx(400), pytest.approx(800), None]
    row = {"scene": "a", "seed": 0, "ssim": 0.9, "processor_seconds": 5}
    points = [("C3GS", 1, 100, 30), ("C3GS", 2, 400, 32), (peers.BASELINE, 9, 800, 31), ("C3GS, static", 1, 9, 31)]
    rows = [row | {"method": m, "lambda_r": s, "bytes": b, "psnr": p} for m, s, b, p in points]
    assert "| a | 31.00 | 0.8 | 0.2 | - |" in peers.report(rows)


def test_a_scene_of_a_splat(tmp_path: Path) -> None:
    """The photographs that are read are those of the splat, from cameras whose up is -y in the world."""
    (tmp_path / "a.ply").write_bytes(write_splats(splats(300, 1), ".ply"))
    assert peers.main(["scene", str(tmp_path / "a.ply"), "-o", str(tmp_path / "scene"), "--size", "24"]) == 0
    photographs = read_photographs(tmp_path / "scene", background=(255, 255, 255))
    assert (len(photographs.train), len(photographs.test)) == (100, 25)
    assert np.mean([p.camera.rotation[1] for p in (*photographs.train, *photographs.test)], axis=0).argmax() == 1


def printed(capsys: pytest.CaptureFixture[str]) -> list[list[str]]:
    """The rows of the table that was printed."""
    lines = [line for line in capsys.readouterr().out.splitlines() if line.startswith("| ")]
    return [line.strip("| ").split(" | ") for line in lines[2:]]


# --- files of other formats -------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_exports(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    """Each scene has a row for itself and each format; a static one has its own degree."""
    monkeypatch.setattr(exports, "ITERATIONS", 0)
    trained = TRAINED.with_name("trained-caliterra.c3gs")
    static = trained.with_name("static-degree-2.c3gs")
    scenes = ["--scene", "a", str(trained), str(CALITERRA), "--scene", "b", str(static), str(CALITERRA)]
    assert main(["exports", *scenes, "--size", "40", "--degree", "0"]) == 0
    rows = printed(capsys)
    assert [row[:3] for row in rows if row[1] == ".sog"] == [["a", ".sog", "0"], ["b", ".sog", "2"]]
    assert len(rows) == 12


@pytest.mark.slow
def test_converted(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    """A splat is coded with two qualities; refcodec's SPZ lies beside them, with the bytes of --fast at its quality."""
    file = tmp_path / "ball.compressed.ply"
    file.write_bytes(write_splats(splats(150, 1), ".ply"))
    monkeypatch.setattr(converted, "tool", lambda: None)
    monkeypatch.setattr(converted, "MOST", 45)
    assert main(["converted", str(tmp_path / "out"), str(file), "--each", "1", "--fast", "30", "60"]) == 0
    whole, low, high, spz, *_ = printed(capsys)
    assert whole[1] == "150 Gaussians"
    assert float(low[6]) + 3 < float(high[6]) <= 45
    assert int(low[2].replace(",", "")) < int(spz[8].replace(",", "")) <= int(high[2].replace(",", ""))


@pytest.mark.skipif(torch.cuda.is_available(), reason="there is a GPU")
def test_without_a_gpu(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["gpu", "--size", "40"]) == 64
    assert "no CUDA device" in capsys.readouterr().err
