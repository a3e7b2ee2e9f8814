"""`infer-list`, the programs that fill it in, and the score of what they wrote."""

from __future__ import annotations

import csv
import os
import re
import subprocess
import sys
import textwrap
from pathlib import Path

import cv2
import numpy as np
import pandas as pd
import pytest

from benchmark.cli.bench import main
from benchmark.data.splits import open_split
from benchmark.evaluation.results import TABLE
from benchmark.metrics.protocols import get_protocol, score_frame
from std_toolkit.geometry import SE3
from tests.benchmark.data.stereo_set import BASELINE_M, LEFT, plane_depth, write_stereo_scene
from tests.benchmark.evaluation.bench_set import SPLIT, write_split
from tests.scene_on_disk import write_scene

EXAMPLES = Path(__file__).resolve().parents[3] / "examples" / "infer"


@pytest.fixture(scope="module")
def root(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_split(tmp_path_factory.mktemp("data"), scenes=2, frames=2)


@pytest.fixture
def listed(root: Path, tmp_path: Path) -> list[dict[str, str]]:
    words = ["--data", str(root), "--split", SPLIT, "--out", str(tmp_path / "todo")]
    assert main(["infer-list", *words, "--engine", "serial"]) == 0
    with (tmp_path / "todo" / "frames.csv").open(newline="") as file:
        return list(csv.DictReader(file))


def run_example(name: str, *words: object) -> None:
    """Run a script in a process that cannot import the toolkit."""
    code = (
        "import runpy, sys; sys.modules['std_toolkit'] = sys.modules['benchmark'] = None; "
        "sys.argv = sys.argv[1:]; runpy.run_path(sys.argv[0])"
    )
    command = [sys.executable, "-c", code, str(EXAMPLES / name), *map(str, words)]
    done = subprocess.run(command, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr


def test_the_list_says_what_the_reader_says(root: Path, listed: list[dict[str, str]]) -> None:
    source = open_split(SPLIT, root)
    assert len(listed) == len(source) == 4
    for index, row in enumerate(listed):
        frame = source.load(index)
        assert (row["scene"], row["frame"]) == (frame.scene, frame.name)
        np.testing.assert_array_equal(cv2.imread(row["color"])[..., ::-1], frame.color)
        raw = cv2.imread(row["raw"], cv2.IMREAD_UNCHANGED) * float(row["raw_unit_m"])
        np.testing.assert_allclose(raw, frame.depth_raw, atol=5.1e-5)
        height, width = frame.color.shape[:2]
        assert (int(row["width"]), int(row["height"])) == (width, height)
        camera = frame.camera.resized(width, height)
        for name in ("fx", "fy", "cx", "cy"):
            assert float(row[name]) == getattr(camera, name)


def test_from_the_list_to_the_score(
    root: Path, tmp_path: Path, listed: list[dict[str, str]]
) -> None:
    """A program that knows nothing of the toolkit scores what its model is worth."""
    import torch

    class Fills(torch.nn.Module):
        """The sensor's depth, and 0.7 m where there is none."""

        def forward(self, color: torch.Tensor, depth: torch.Tensor) -> torch.Tensor:
            return torch.where(depth > 0, depth, torch.full_like(depth, 0.7)) + 0 * color[:, :1]

    model = tmp_path / "model.pt"
    torch.jit.script(Fills()).save(str(model))
    run_example("plain_torch.py", tmp_path / "todo" / "frames.csv", model)
    words = ["depth", "--data", str(root), "--split", SPLIT, "--out", str(tmp_path / "out")]
    words += ["--engine", "serial", "--no-gallery", "--no-speed", "--method"]
    assert main([*words, f"mine={tmp_path / 'todo' / 'predictions'}"]) == 0
    table = pd.read_parquet(tmp_path / "out" / SPLIT / "mine" / "strict" / TABLE)
    rows = table[(table["grid"] == "h126w224") & (table["subset"] == "all")]
    source = open_split(SPLIT, root)
    for index, found in enumerate(rows["rmse"]):
        frame = source.load(index)
        wanted = np.where(frame.depth_raw > 0, frame.depth_raw, np.float32(0.7))
        errors = score_frame(wanted, frame, get_protocol())[0].errors
        # Raw depth was enlarged to the size of colour, by another nearest pixel.
        assert found == pytest.approx(errors.rmse, rel=0.05) and found > 0.01
    assert (rows["coverage"] == 1).all()
    # A second list into the same folder goes on; another limit writes another list.
    again = ["infer-list", "--data", str(root), "--split", SPLIT, "--out", str(tmp_path / "todo")]
    assert main([*again, "--limit", "1", "--engine", "serial"]) == 0
    assert len((tmp_path / "todo" / "frames.csv").read_text().splitlines()) == 2


def test_with_transformers(root: Path, tmp_path: Path, listed: list[dict[str, str]]) -> None:
    """A tiny model of random weights: its numbers are worth nothing, its shapes are."""
    transformers = pytest.importorskip("transformers")
    backbone = transformers.Dinov2Config(
        hidden_size=16, num_hidden_layers=4, num_attention_heads=2, image_size=56, patch_size=14,
        out_features=["stage1", "stage2", "stage3", "stage4"], reshape_hidden_states=False,
        apply_layernorm=True,
    )  # fmt: skip
    config = transformers.DepthAnythingConfig(
        backbone_config=backbone, reassemble_hidden_size=16, neck_hidden_sizes=[8, 8, 8, 8],
        fusion_hidden_size=8, head_hidden_size=4, patch_size=14,
    )  # fmt: skip
    transformers.DepthAnythingForDepthEstimation(config).save_pretrained(tmp_path / "model")
    run_example("depth_anything.py", tmp_path / "todo" / "frames.csv", tmp_path / "model")
    words = ["depth", "--data", str(root), "--split", SPLIT, "--out", str(tmp_path / "out")]
    words += ["--engine", "serial", "--protocol", "aligned-frame", "--method"]
    assert main([*words, f"da={tmp_path / 'todo' / 'predictions'}"]) == 0
    table = pd.read_parquet(tmp_path / "out" / SPLIT / "da" / "aligned-frame" / TABLE)
    assert (table["coverage"] > 0.99).all() and np.isfinite(table["rmse"]).all()


def test_the_container_names_files_that_are_there() -> None:
    text = (EXAMPLES / "Dockerfile").read_text()
    assert re.search(r"^COPY plain_torch.py model.pt /$", text, re.MULTILINE)
    assert (EXAMPLES / "plain_torch.py").is_file()
    for path in EXAMPLES.glob("*.py"):
        assert len(path.read_text().splitlines()) < (80 if path.stem == "frame_list" else 60)


def test_scenes_of_the_toolkit_and_wrong_folders(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = ["infer-list", "--split", "scenes", "--engine", "serial", "--out"]
    (tmp_path / "none").mkdir()
    assert main([*words, str(tmp_path / "out"), "--data", str(tmp_path / "none")]) == 1
    assert len(capsys.readouterr().err.strip().splitlines()) == 1
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "notes.txt").touch()
    write_scene(tmp_path / "scenes" / "a")
    assert main([*words, str(tmp_path / "mine"), "--data", str(tmp_path / "scenes")]) != 0
    assert "mine" in capsys.readouterr().err


# What the scripts call of each package, as its README has it; each halves the sensor's depth.
STAND_INS = {
    "cdm": (
        "rgbddepth/dpt.py",
        """
        class RGBDDepth:
            def __init__(self, encoder, features, out_channels): assert encoder == "vitl"
            def load_state_dict(self, state): assert list(state) == ["weight"]
            def to(self, device): return self
            def eval(self): return self
            def infer_image(self, image, depth, input_size):
                assert image.dtype == "uint8" and input_size == 518
                return 2 * depth  # inverse
        """,
    ),
    "lingbot_depth": (
        "mdm/model/v2.py",
        """
        class MDMModel:
            @classmethod
            def from_pretrained(cls, path): return cls()
            def to(self, device): return self
            def eval(self): return self
            def infer(self, image, depth_in, intrinsics):
                assert image.shape[1] == 3 and 0.1 < image.max() <= 1
                assert image.shape[2:] == depth_in.shape[1:]
                assert 0.2 < intrinsics[0, 0, 2] < 0.8 and 0.2 < intrinsics[0, 1, 2] < 0.8
                return {"depth": depth_in / 2}
        """,
    ),
    "prior_da": (
        "prior_depth_anything/__init__.py",
        """
        import torch
        class PriorDepthAnything:
            def __init__(self, device): pass
            def infer_one_sample(self, image, prior, visualize):
                assert image.dtype == "uint8" and not visualize
                return torch.from_numpy(prior)[None, None] / 2
        """,
    ),
    "d3roma": (
        "inference.py",
        """
        class D3RoMa:
            def __init__(self, overrides, camera, variant):
                assert variant == "rgb+raw" and "task.image_size=[360,640]" in overrides
                assert camera.resolution == (360, 640)
                self.camera = camera
            def infer_with_rgb_raw(self, rgb, raw_depth):
                assert rgb.dtype == "uint8" and raw_depth.shape == (360, 640)
                assert 5 < self.camera.fxb_depth < 80  # pixels times metres at that size
                return raw_depth / 2
        """,
    ),
    "da3": (
        "depth_anything_3/api.py",
        """
        from types import SimpleNamespace
        class DepthAnything3:
            @classmethod
            def from_pretrained(cls, path): return cls()
            def to(self, device): return self
            def eval(self): return self
            def inference(self, image):
                (color,) = image
                return SimpleNamespace(depth=color[None, ..., 0] / 255)
        """,
    ),
}


@pytest.mark.parametrize("name", STAND_INS)
def test_scripts_hand_over_what_their_packages_take(
    name: str, tmp_path: Path, listed: list[dict[str, str]]
) -> None:
    """The packages and their weights are not here: a stand-in sees what the script gives it."""
    import torch

    path, text = STAND_INS[name]
    module = tmp_path / "packages" / path
    module.parent.mkdir(parents=True)
    module.write_text(textwrap.dedent(text))
    weights = tmp_path / "weights.pth"
    torch.save({"model": {"module.weight": torch.zeros(1)}}, weights)
    done = subprocess.run(
        [sys.executable, EXAMPLES / f"{name}.py", tmp_path / "todo" / "frames.csv", weights],
        capture_output=True, text=True,
        env=os.environ | {"PYTHONPATH": str(tmp_path / "packages")},
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    for row in listed:
        found = np.load(row["out"])
        color = cv2.imread(row["color"])[..., ::-1]
        raw = cv2.imread(row["raw"], cv2.IMREAD_UNCHANGED) * np.float32(row["raw_unit_m"])
        size = (color.shape[1], color.shape[0])
        wanted = cv2.resize(raw, size, interpolation=cv2.INTER_NEAREST) / 2
        if name == "da3":
            wanted = color[..., 0] / 255
        if name == "d3roma":
            wanted = cv2.resize(wanted, (640, 360), interpolation=cv2.INTER_NEAREST)
        np.testing.assert_allclose(found, wanted, rtol=1e-5)
        assert found.dtype == np.float32 and found.any()
    first = Path(listed[0]["out"])
    first.unlink()
    kept = {row["out"]: Path(row["out"]).stat().st_mtime_ns for row in listed[1:]}
    assert "not run" in (EXAMPLES / f"{name}.py").read_text().lower().replace("\n", " ")
    assert subprocess.run(
        [sys.executable, EXAMPLES / f"{name}.py", tmp_path / "todo" / "frames.csv", weights],
        env=os.environ | {"PYTHONPATH": str(tmp_path / "packages")},
    ).returncode == 0  # fmt: skip
    assert first.exists() and all(Path(p).stat().st_mtime_ns == t for p, t in kept.items())


def test_disparity_of_an_infrared_pair_becomes_depth_of_colour(tmp_path: Path) -> None:
    """A stand-in knows the disparity of the plane: what the list and the loop do is exact then."""
    data = tmp_path / "data"
    write_stereo_scene(data / "DREDS-CatKnown" / "val" / "shapenet_generate_1216_val_novel" / "0")
    todo = tmp_path / "todo"
    words = ["--data", str(data), "--split", "dreds-catknown-val"]
    assert main(["infer-list", *words, "--out", str(todo), "--engine", "serial"]) == 0
    disparity = LEFT.fx * BASELINE_M / plane_depth(LEFT, SE3.identity())
    np.save(tmp_path / "disparity.npy", disparity)
    core = tmp_path / "packages" / "core"
    (core / "utils").mkdir(parents=True)
    (core / "foundation_stereo.py").write_text(
        textwrap.dedent(f"""
        import numpy as np, torch
        class FoundationStereo(torch.nn.Module):
            def __init__(self, config):
                super().__init__()
                assert config["vit_size"] == "vitl" and config["max_disp"] == 416
                self.weight = torch.nn.Parameter(torch.zeros(1))
            def forward(self, left, right, iters, test_mode):
                assert left.shape == right.shape == (1, 3, 192, 320) and 1 < left.max() <= 255
                assert (left != right).any() and iters == 32 and test_mode
                found = torch.zeros(1, 1, 192, 320)
                found[..., :180, :] = torch.tensor(np.load({str(tmp_path / "disparity.npy")!r}))
                return found
        """)
    )
    (core / "utils" / "utils.py").write_text(
        textwrap.dedent("""
        import torch
        class InputPadder:
            def __init__(self, shape, divis_by, force_square):
                self.rows, self.more = shape[-2], -shape[-2] % divis_by
            def pad(self, *images):
                return [torch.nn.functional.pad(i, (0, 0, 0, self.more)) for i in images]
            def unpad(self, image): return image[..., :self.rows, :]
        """)
    )
    (tmp_path / "packages" / "omegaconf.py").write_text(
        textwrap.dedent("""
        class OmegaConf:
            @staticmethod
            def load(path):
                return dict(line.split(": ") for line in path.read_text().splitlines()) | {
                    "max_disp": 416}
        """)
    )
    (tmp_path / "cfg.yaml").write_text("max_disp: 416\n")
    import torch

    torch.save({"model": {"weight": torch.zeros(1)}}, tmp_path / "weights.pth")
    done = subprocess.run(
        [sys.executable, EXAMPLES / "foundation_stereo.py", todo / "frames.csv",
         tmp_path / "weights.pth"],
        capture_output=True, text=True,
        env=os.environ | {"PYTHONPATH": str(tmp_path / "packages")},
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    score = ["depth", *words, "--out", str(tmp_path / "out"), "--engine", "serial", "--no-gallery"]
    assert main([*score, "--no-speed", "--method", f"fs={todo / 'predictions'}"]) == 0
    table = pd.read_parquet(tmp_path / "out" / "dreds-catknown-val" / "fs" / "strict" / TABLE)
    rows = table[(table["subset"] == "all") & (table["grid"] == "native")]
    assert len(rows) == 2
    # The nearest point lies up to half a pixel aside: 0.3 mm on this plane.
    assert (rows["rmse_answered"] < 5e-4).all()
    assert (rows["n_answered"] / rows["n_pixels"] > 0.85).all()


def test_a_list_without_pairs_is_refused_by_the_loop(
    tmp_path: Path, listed: list[dict[str, str]]
) -> None:
    assert "ir_left" not in listed[0]
    code = (
        f"import sys; sys.path.insert(0, {str(EXAMPLES)!r}); import frame_list; "
        f"frame_list.fill_from_pair({str(tmp_path / 'todo' / 'frames.csv')!r}, None)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert done.returncode == 1 and "no infrared pair" in done.stderr
    assert len(done.stderr.strip().splitlines()) == 1
