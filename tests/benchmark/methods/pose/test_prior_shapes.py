"""Priors: mean shapes of sets of points, the file that they are kept in, and the command."""

import numpy as np
import pytest
import torch
import trimesh
from safetensors.numpy import save_file

from benchmark.cli.bench import main
from benchmark.methods.pose.priors import prior_file
from benchmark.methods.pose.priors.autoencoder import AutoencoderOptions, mean_shapes
from benchmark.methods.pose.priors.make_priors import barycentre, sample_shapes, surface_points
from benchmark.methods.pose.priors.prior_file import Priors, load_priors, save_priors
from sensors.assets import SourceOptions, open_source
from std_toolkit.errors import ToolkitError


def _boxes(sides, points=128, seed=0):
    """Points on boxes, those of each box drawn anew and in an order of its own."""
    rng = np.random.default_rng(seed)
    found = []
    for side in sides:
        p = rng.uniform(-1, 1, (points, 3))
        axis = rng.integers(3, size=points)
        p[np.arange(points), axis] = np.sign(p[np.arange(points), axis])
        found.append(p * np.asarray(side) / 2)
    return np.array(found)


def _meshes(folder, categories=("mug", "can"), count=2):
    for category in categories:
        (folder / category).mkdir(parents=True)
        for k in range(count):
            box = trimesh.creation.box((1.0, 1.0 + k, 2.0))
            box.export(folder / category / f"{k}.obj")
    return folder


def test_points_are_evenly_spread_over_a_surface():
    """Of a box of 1 x 1 x 2 each square side has a tenth of the area, each other side a fifth."""
    box = trimesh.creation.box((1, 1, 2))
    points = surface_points(box.vertices, box.faces, 4000, (0, "box"))
    assert np.allclose(np.abs(points / [0.5, 0.5, 1.0]).max(axis=1), 1, atol=1e-6)
    for axis, share in ((0, 0.2), (1, 0.2), (2, 0.1)):
        for side in (-1, 1):
            on_side = np.isclose(points[:, axis], side * (0.5, 0.5, 1.0)[axis])
            assert on_side.mean() == pytest.approx(share, abs=0.03)
    again = surface_points(box.vertices, box.faces, 4000, (0, "box"))
    assert np.array_equal(points, again)
    assert not np.array_equal(points, surface_points(box.vertices, box.faces, 4000, (0, "other")))


def test_a_surface_without_area_is_refused():
    with pytest.raises(ToolkitError, match="no area"):
        surface_points(np.zeros((3, 3)), np.array([[0, 1, 2]]), 5, (0, "nothing"))


def test_shapes_are_drawn_once_each_and_in_the_canonical_frame(tmp_path):
    source = open_source("folder", SourceOptions(root=_meshes(tmp_path / "m", count=3)))
    shapes = sample_shapes(source, "mug", instances=10, points=500)
    assert len(shapes.ids) == len(set(shapes.ids)) == 3
    assert shapes.points.shape == (3, 500, 3)
    size = np.ptp(shapes.points, axis=1)
    assert np.linalg.norm(size, axis=1) == pytest.approx(1, abs=0.02)
    assert len(sample_shapes(source, "mug", instances=2, points=9).ids) == 2
    with pytest.raises(ToolkitError, match="no such category"):
        sample_shapes(source, "car", instances=1, points=9)


def test_the_barycentre_of_one_shape_is_that_shape():
    (box,) = _boxes([(1, 0.5, 0.5)])
    shuffled = box[np.random.default_rng(1).permutation(len(box))]
    found = barycentre(np.stack([box, shuffled]))
    assert np.allclose(np.sort(found, axis=0), np.sort(box, axis=0).astype(np.float32))


def test_the_barycentre_of_boxes_is_the_box_between_them():
    sides = [(0.9, 0.3, 0.3), (0.5, 0.3, 0.7), (0.7, 0.3, 0.5)]
    found = barycentre(_boxes(sides, points=200))
    extent = 2 * np.quantile(np.abs(found), 0.97, axis=0)
    assert extent == pytest.approx((0.7, 0.3, 0.5), abs=0.06)
    with pytest.raises(ToolkitError, match="needs shapes"):
        barycentre(np.zeros((0, 5, 3)))


@pytest.mark.slow
def test_the_auto_encoders_mean_is_near_the_shapes_and_lies_between_categories():
    torch.set_num_threads(1)
    flat = _boxes([(0.9, 0.1, 0.4)] * 6, points=64).astype(np.float32)
    tall = _boxes([(0.2, 0.9, 0.3)] * 6, points=64, seed=1).astype(np.float32)
    losses = []
    found = mean_shapes(
        {"flat": flat, "tall": tall},
        AutoencoderOptions(
            points=32,
            embedding=8,
            encoder=(16, 32),
            decoder=(32,),
            batch=12,
            epochs=250,
            learning_rate=3e-3,
        ),
        lambda epoch, loss: losses.append((epoch, loss)),
    )
    assert len(losses) == 250 and losses[-1][1] < losses[0][1] / 5
    assert found["flat"].shape == (32, 3)
    for name, side in (("flat", (0.9, 0.1, 0.4)), ("tall", (0.2, 0.9, 0.3))):
        extent = np.ptp(found[name], axis=0)
        assert extent == pytest.approx(side, abs=0.2)
    with pytest.raises(ToolkitError, match="no shapes"):
        mean_shapes({})


def test_priors_come_back_as_they_were_written(tmp_path):
    points = {name: _boxes([(0.5, 0.6, 0.6)], seed=k)[0] for k, name in enumerate(("mug", "can"))}
    path = tmp_path / "p.safetensors"
    save_priors(path, Priors(points, {"how": "by hand"}))
    found = load_priors(path)
    assert found.about == {"how": "by hand"}
    assert np.array_equal(found.of(["can", "mug"])[0], points["can"].astype(np.float32))
    with pytest.raises(ToolkitError, match=r"no prior of this category.*spoon"):
        found.of(["spoon"])


def test_what_is_no_file_of_priors_is_refused(tmp_path):
    with pytest.raises(ToolkitError, match="no such file"):
        load_priors(tmp_path / "missing.safetensors")
    damaged = tmp_path / "damaged.safetensors"
    damaged.write_bytes(b"nothing of the kind")
    with pytest.raises(ToolkitError, match="not a file of safetensors"):
        load_priors(damaged)
    other = tmp_path / "other.safetensors"
    save_file({"mug": np.zeros((4, 3), np.float32)}, other)
    with pytest.raises(ToolkitError, match="not a file of priors"):
        load_priors(other)
    save_file(
        {"mug": np.full((4, 3), np.nan)}, other, metadata={"priors": '{"format": "std-priors-1"}'}
    )
    with pytest.raises(ToolkitError, match=r"other\.safetensors.*mug.*finite"):
        load_priors(other)
    with pytest.raises(ToolkitError, match=r"\*\.safetensors"):
        save_priors(tmp_path / "p.npz", Priors({"mug": np.zeros((4, 3), np.float32)}))


def test_priors_that_were_shipped_are_known_by_their_digest(tmp_path, monkeypatch):
    found = load_priors("builtin")
    assert found.about["assets"] == "builtin"
    points = found.of(("bottle", "bowl", "camera", "can", "car", "mug", "aeroplane"))
    assert points.shape == (7, 1024, 3)
    # Centred shapes of diagonal 1, the long axis of a bottle upright and of a car lying.
    extent = np.ptp(points, axis=1)
    assert (np.abs(points.mean(axis=1)) < 0.1).all()
    assert np.linalg.norm(extent, axis=1) == pytest.approx(1, abs=0.12)
    assert extent[0].argmax() == 1 and extent[4].argmax() != 1
    changed = tmp_path / "builtin.safetensors"
    original = prior_file._BUILTIN_FILE
    changed.write_bytes(original.read_bytes()[:-1] + b"\x00")
    digest = original.with_name(original.name + ".sha256")
    (tmp_path / digest.name).write_bytes(digest.read_bytes())
    monkeypatch.setattr(prior_file, "_BUILTIN_FILE", changed)
    with pytest.raises(ToolkitError, match="SHA-256 differs"):
        load_priors("builtin")


@pytest.mark.slow
@pytest.mark.parametrize("how", ["barycentre", "autoencoder"])
def test_the_command_makes_priors_of_a_folder_of_meshes(how, tmp_path, capsys):
    root, out = _meshes(tmp_path / "m"), tmp_path / "out" / "p.safetensors"
    command = ["priors", "--assets", "folder", "--root", str(root), "--split", "all"]
    command += ["--points", "48", "--how", how, "--epochs", "3", "--out", str(out)]
    assert main(command) == 0
    found = load_priors(out)
    assert sorted(found.points) == ["can", "mug"] and found.points["can"].shape == (48, 3)
    assert found.about["how"] == how and "mug 2" in found.about["instances"]
    first = out.read_bytes()
    assert main(command) == 0 and out.read_bytes() == first


def test_the_command_tells_what_is_wrong_in_a_line(tmp_path, capsys):
    root = _meshes(tmp_path / "m")
    out = str(tmp_path / "p.safetensors")
    assert main(["priors", "--assets", "folder", "--root", str(root), "--out", "p.npz"]) == 2
    command = ["priors", "--assets", "folder", "--root", str(root), "--split", "all"]
    assert main([*command, "--categories", "spoon", "--out", out]) == 1
    assert main([*command, "--instances", "0", "--out", out]) == 2
    told = [line for line in capsys.readouterr().err.splitlines() if line.startswith("error")]
    assert len(told) == 3 and "spoon" in told[1]
    assert not (tmp_path / "p.safetensors").exists()
