"""Frames that are turned, mirrored and enlarged: images, depth and masks stay of one scene."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest
import torch
from training_set import packed, trained, wishes, write_scenes

from benchmark.methods.torch_camera import points_of
from benchmark.training.plan import plan_training
from benchmark.training.step import ModelInput
from std_toolkit.errors import ToolkitError

SIDE = (48, 64)  # height, width
# Pixels are not square, as those of a picture that was squeezed.
K = torch.tensor([[60.0, 0, 30.7], [0, 90.0, 24.2], [0, 0, 1]])


def a_scene(count: int) -> ModelInput:
    """A slanted plane whose colour tells x and y, with a box of which the sensor sees nothing."""
    h, w = SIDE
    rays = points_of(torch.ones(count, 1, h, w), K.expand(count, 3, 3))
    true = 0.8 / (rays * torch.tensor([0.2, -0.3, 1.0]).reshape(1, 3, 1, 1)).sum(1, keepdim=True)
    mask = torch.full((count, h, w), 255, dtype=torch.uint8)
    mask[:, 15:30, 20:40] = 7
    depth = true.masked_fill((mask == 7)[:, None], 0.0)
    at = rays * true
    color = torch.cat([at[:, :2] + 0.5, (mask == 7)[:, None].float()], dim=1)
    batch = {
        "color": torch.zeros(1), "raw": torch.zeros(1), "true": true[:, 0], "mask": mask,
        "materials": torch.zeros(count, 256), "K": K.expand(count, 3, 3),
        "index": torch.arange(count), "more": torch.zeros(1),
    }  # fmt: skip
    return ModelInput(color, depth, batch)


def drawn(monkeypatch, scale: float, degrees: float, side: float) -> None:
    from benchmark.training.augmentation import frames as augmentation

    def motions(count):
        angle = torch.tensor(degrees).deg2rad()
        cosine, sine = scale * angle.cos(), scale * angle.sin()
        motion = torch.tensor([[side * cosine, -sine], [side * sine, cosine]])
        return motion.expand(count, 2, 2), torch.full((count,), scale)

    monkeypatch.setattr(augmentation, "_motions", motions)


def test_nothing_drawn_changes_nothing(monkeypatch):
    from benchmark.training.augmentation.frames import moved

    drawn(monkeypatch, 1.0, 0.0, 1.0)
    seen = a_scene(2)
    found = moved(seen)
    torch.testing.assert_close(found.color, seen.color, rtol=0, atol=1e-4)
    assert torch.equal(found.batch["mask"], seen.batch["mask"])
    torch.testing.assert_close(found.batch["true"], seen.batch["true"])
    torch.testing.assert_close(found.depth, seen.depth)
    assert set(found.batch) == {"true", "mask", "materials", "K", "index"}


@pytest.mark.parametrize(
    ("scale", "degrees", "side"),
    [(1.0, 5.0, 1.0), (1.0, 0.0, -1.0), (1.5, 0.0, 1.0), (1.3, -4, -1)],
)
def test_points_of_the_scene_move_as_one(monkeypatch, scale, degrees, side):
    """What the moved depth and the same camera say of a pixel is the point that its colour names,
    turned about the camera's axis, mirrored, and divided in depth alone."""
    from benchmark.training.augmentation.frames import moved

    drawn(monkeypatch, scale, degrees, side)
    found = moved(a_scene(1))
    true, mask = found.batch["true"][:, None], found.batch["mask"]
    at = points_of(true, found.batch["K"])
    named = found.color[:, :2] - 0.5
    angle = torch.tensor(float(degrees)).deg2rad()
    x, y = side * named[:, 0], named[:, 1]
    expected = torch.stack(
        [x * angle.cos() - y * angle.sin(), x * angle.sin() + y * angle.cos()], 1
    )
    inner = torch.zeros_like(true, dtype=torch.bool)
    inner[..., 6:-6, 6:-6] = True
    known = (true > 0) & inner
    assert known.sum() > 0.9 * inner.sum()
    apart = (at[:, :2] - expected).abs().amax(dim=1, keepdim=True)[known]
    assert apart.max() < 0.012  # a pixel, by which the nearest one may be off
    assert apart.mean() < 0.004
    # The depth is that of the plane through the moved points, with z divided.
    z = (0.8 - 0.2 * named[:, 0] + 0.3 * named[:, 1]) / scale
    assert (true[:, 0] - z).abs()[known[:, 0]].max() < 0.01
    # The sensor sees nothing on the box, and all else.
    assert torch.equal(found.depth[:, 0] == 0, (mask == 7) | (true[:, 0] == 0))
    edge = (found.color[:, 2] > 0.05) & (found.color[:, 2] < 0.95)
    assert torch.equal((mask == 7) & ~edge, (found.color[:, 2] > 0.5) & ~edge)
    assert ((mask == 7) | (mask == 255)).all()


def test_an_enlarged_box_is_larger_by_the_square(monkeypatch):
    from benchmark.training.augmentation.frames import moved

    drawn(monkeypatch, 1.5, 0.0, 1.0)
    seen = a_scene(1)
    before, after = (int((one.batch["mask"] == 7).sum()) for one in (seen, moved(seen)))
    assert after / before == pytest.approx(1.5**2, rel=0.1)


def test_what_comes_from_outside_is_unknown(monkeypatch):
    from benchmark.training.augmentation.frames import moved

    drawn(monkeypatch, 1.0, 5.0, 1.0)
    found = moved(a_scene(1))
    outside = found.batch["true"][0] == 0
    assert 0 < outside.float().mean() < 0.1
    assert (found.batch["mask"][0][outside] == 255).all()
    assert (found.depth[0, 0][outside] == 0).all()


def test_draws_are_the_published_ones_and_the_seeds_alone():
    from benchmark.training.augmentation import frames as augmentation

    torch.manual_seed(3)
    motion, scale = augmentation._motions(4000)
    torch.manual_seed(3)
    assert torch.equal(augmentation._motions(4000)[0], motion)
    assert 1 <= scale.min() < 1.01 and 1.49 < scale.max() <= 1.5
    mirrored = torch.linalg.det(motion) < 0
    assert mirrored.float().mean().item() == pytest.approx(0.5, abs=0.03)
    angle = torch.atan2(-motion[:, 0, 1], motion[:, 1, 1]).rad2deg()
    assert -5 <= angle.min() < -4.9 and 4.9 < angle.max() <= 5
    torch.testing.assert_close(torch.linalg.det(motion).abs().sqrt(), scale)


def test_jitter_changes_brightness_contrast_and_saturation():
    from benchmark.training.augmentation.color import jitter

    draw = torch.Generator().manual_seed(0)
    images = torch.rand(60, 3, 16, 16, generator=draw) * 0.4 + 0.3
    torch.manual_seed(0)
    changed = jitter()(images)
    assert changed.min() >= 0 and changed.max() <= 1
    brightness = changed.mean(dim=(1, 2, 3)) / images.mean(dim=(1, 2, 3))
    assert 0.5 < brightness.min() < 0.8 and 1.2 < brightness.max() < 1.5
    contrast = changed.mean(1).std(dim=(1, 2)) / images.mean(1).std(dim=(1, 2))
    assert contrast.min() < 0.75 and contrast.max() > 1.25


@pytest.fixture(scope="module")
def pack(tmp_path_factory: pytest.TempPathFactory) -> Path:
    top = tmp_path_factory.mktemp("geometry")
    return packed(top / "pack", write_scenes(top / "data"))


@pytest.mark.parametrize(
    ("method", "changes", "expected"),
    [
        ("nlspn", {}, (False, True, True)),
        ("nlspn", {"geometry": "off", "colors": "off"}, (False, False, False)),
        ("nlspn", {"colors": "on"}, (True, False, True)),
        ("swindrnet", {}, (True, False, False)),
        ("dfnet", {"geometry": "on", "colors": "jitter"}, (False, True, True)),
        ("cleargrasp", {}, (True, False, False)),
        ("lidf", {}, (False, False, False)),
    ],
)
def test_what_is_augmented(method, changes, expected, pack):
    config = plan_training(wishes(method, pack, **changes))[0]
    assert (config.colors, config.jitter, config.geometry) == expected


def test_methods_whose_maps_cannot_be_moved_refuse(pack, monkeypatch):
    from benchmark.training import plan

    fixed = replace(plan.get_trainable("dfnet"), geometry=None)
    monkeypatch.setattr(plan, "get_trainable", lambda _: fixed)
    assert not plan_training(wishes("dfnet", pack))[0].geometry
    with pytest.raises(ToolkitError, match="--geometry: frames of this method cannot be moved"):
        plan_training(wishes("dfnet", pack, geometry="on"))


def test_a_training_with_all_of_it(pack, tmp_path):
    weights = trained(wishes("dfnet", pack, steps=2, geometry="on", colors="jitter"), tmp_path)
    assert all(torch.isfinite(t).all() for t in weights.values())
