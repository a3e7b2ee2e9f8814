"""Augmentation in which colour alone tells: holes anywhere, glass gone or seen through, wrong
colours. Each does what it says, by its seed, and changes nothing else."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from benchmark.data.frame import BACKGROUND, Material
from benchmark.training.augmentation import holes
from benchmark.training.augmentation.depth import (
    clear_depth,
    continued,
    with_noise,
    without_objects,
    wrong_color,
)
from benchmark.training.augmentation.frames import copy_paste, cropped, moved, with_patterns
from benchmark.training.augmentation.holes import CAUSES, cut_holes, smooth_field
from benchmark.training.options import TrainOptions
from benchmark.training.step import ModelInput
from std_toolkit.errors import ToolkitError

H, W, F = 96, 160, 150.0
BOTTLE, BOX = 3, 9  # of glass, and opaque


def table() -> torch.Tensor:
    """(H, W) exact depth of a table seen from above at an angle."""
    v = torch.arange(H)[:, None].expand(H, W)
    u = torch.arange(W)[None].expand(H, W)
    return 1 / (1.1 + 0.004 * v + 0.0008 * u)


def frames(count: int = 6) -> ModelInput:
    """A bottle and a box on the table, of which the sensor sees all, with a few mm of noise."""
    torch.manual_seed(5)
    true = table().expand(count, H, W).clone()
    mask = torch.full((count, H, W), BACKGROUND, dtype=torch.uint8)
    mask[:, 30:70, 40:60], mask[:, 40:60, 100:130] = BOTTLE, BOX
    true[mask == BOTTLE], true[mask == BOX] = 0.60, 0.55
    materials = torch.full((count, 256), 255, dtype=torch.uint8)
    materials[:, BOTTLE], materials[:, BOX] = Material.TRANSPARENT, Material.DIFFUSE
    K = torch.tensor([[F, 0, W / 2], [0, F, H / 2], [0, 0, 1]]).expand(count, 3, 3)
    color = smooth_field(3 * count, H, W, torch.device("cpu")).reshape(count, 3, H, W)
    depth = (true * (1 + 0.001 * torch.randn(true.shape)))[:, None]
    return ModelInput(color, depth, {"true": true, "mask": mask, "materials": materials, "K": K})


def gone(before: ModelInput, after: torch.Tensor) -> torch.Tensor:
    """(b, h, w) holes; whatever is left is as it was."""
    assert torch.equal(after[after > 0], before.depth[after > 0])
    return (after == 0)[:, 0] & (before.depth > 0)[:, 0]


def of_cause(name: str, monkeypatch: pytest.MonkeyPatch, count: int = 24) -> torch.Tensor:
    monkeypatch.setattr(holes, "CAUSES", {name: CAUSES[name]})
    monkeypatch.setattr(holes, "_EACH", 1.0)
    inputs = frames(count)
    torch.manual_seed(1)
    return gone(inputs, cut_holes(inputs, 1.0))


@pytest.mark.parametrize("size", [(80, 48), (64, 48), (36, 64), (240, 144)])
def test_a_part_of_frames_at_another_size_shows_the_same_points(size: tuple[int, int]) -> None:
    """Points of depth and intrinsics stay where they were, and colour stays on its surface."""
    inputs = frames(2)
    v, u = (a.float() for a in torch.meshgrid(torch.arange(H), torch.arange(W), indexing="ij"))
    color = torch.stack([u / W, v / H, torch.zeros_like(u)]).expand(2, 3, H, W)
    found = cropped(inputs._replace(color=color), size)
    w, h = size
    assert found.depth.shape == (2, 1, h, w) and found.color.shape == (2, 3, h, w)
    K = found.batch["K"][0]
    b, a = (a.float() for a in torch.meshgrid(torch.arange(h), torch.arange(w), indexing="ij"))
    x, y = (a - K[0, 2]) / K[0, 0], (b - K[1, 2]) / K[1, 1]
    before_u, before_v = F * x + W / 2, F * y + H / 2
    inner = (slice(2, -2), slice(2, -2))
    assert (found.color[0, 0] * W - before_u)[inner].abs().max() < 0.05
    assert (found.color[0, 1] * H - before_v)[inner].abs().max() < 0.05
    # Depth goes by the nearest pixel: at most one pixel of the larger image away.
    plain = 1 / (1.1 + 0.004 * before_v + 0.0008 * before_u)
    on_table = found.batch["mask"][0] == BACKGROUND
    step = max(1.0, F / float(K[0, 0]))
    assert (1 / found.batch["true"][0] - 1 / plain)[on_table].abs().max() < 0.005 * step
    assert set(found.batch["mask"].unique().tolist()) <= {BOTTLE, BOX, BACKGROUND}


def test_patterns_lie_on_the_floor_and_are_seen_through_glass() -> None:
    inputs = frames(200)._replace(color=torch.full((200, 3, H, W), 0.5))
    torch.manual_seed(0)
    changed = with_patterns(inputs, 0.5)
    apart = (changed - 0.5).abs().mean(dim=1)
    mask = inputs.batch["mask"]
    chosen = apart.flatten(1).amax(dim=1) > 0
    assert chosen.float().mean() == pytest.approx(0.5, abs=0.1)
    floor, glass, box = (apart[chosen][mask[chosen] == i] for i in (BACKGROUND, BOTTLE, BOX))
    assert (box == 0).all()
    assert 0.03 < float(floor.mean()) < 0.3
    assert float(glass.mean()) == pytest.approx(0.7 * float(floor.mean()), rel=0.1)
    assert ((changed >= 0) & (changed <= 1)).all()


def test_noise_of_stereo_grows_with_the_square_of_the_distance() -> None:
    depth = torch.tensor([0.5, 1.0, 2.0]).repeat(400)[:, None, None, None].expand(-1, 1, 24, 32)
    torch.manual_seed(0)
    apart = (with_noise(depth, 1.0) - depth).reshape(400, 3, -1)
    half, one, two = apart.square().mean(dim=(0, 2)).sqrt().tolist()
    assert one / half == pytest.approx(4, rel=0.15) and two / one == pytest.approx(4, rel=0.15)
    assert 0.0005 < one < 0.003
    some = with_noise(depth, 0.5)
    moved_frames = (some != depth).flatten(1).any(dim=1).float().mean()
    assert moved_frames == pytest.approx(0.5, abs=0.05)
    assert (with_noise(torch.zeros(2, 1, 24, 32), 1.0) == 0).all()


def test_a_scene_without_its_objects_is_the_table() -> None:
    inputs = frames(2)
    objects = inputs.batch["mask"] != BACKGROUND
    found = without_objects(inputs.batch["true"], objects)
    assert (found - table())[objects].abs().max() < 1e-3
    assert torch.equal(found[~objects], inputs.batch["true"][~objects])
    # At the border there is no far side to continue from: the plane tells.
    objects[:] = False
    objects[:, 60:, :50] = True
    assert (without_objects(table().expand(2, H, W), objects) - table())[objects].abs().max() < 1e-3


def test_what_stands_behind_the_table_does_not_bend_it() -> None:
    """A wall over the upper third, and a box: the fit is that of the table, and at the wall the
    outlines decide."""
    true = table().clone()
    true[:30] = 1.4
    true[70:90, 5:30] = 0.5
    objects = torch.zeros(H, W, dtype=torch.bool)
    objects[60:80, 60:90] = True
    found = without_objects(true[None], objects[None])[0]
    assert (found - table())[objects].abs().max() < 3e-3
    high = torch.zeros(H, W, dtype=torch.bool)
    high[5:20, 60:90] = True
    assert (without_objects(true[None], high[None])[0][high] - 1.4).abs().max() < 0.05
    nothing = without_objects(0 * true[None], objects[None])
    assert torch.isfinite(nothing).all() and (nothing == 0).all()


def test_glass_is_gone_or_seen_through_in_the_stated_shares() -> None:
    inputs = frames(600)
    torch.manual_seed(0)
    found = clear_depth(inputs, 0.3, 0.5)[:, 0]
    before, mask = inputs.depth[:, 0], inputs.batch["mask"]
    far = torch.ones_like(mask, dtype=torch.bool)
    far[:, 28:72, 38:62] = False  # the bottle and two pixels around
    assert torch.equal(found[far], before[far])
    bottle = found[mask == BOTTLE].reshape(600, -1)
    behind = table().expand(600, H, W)[mask == BOTTLE].reshape(600, -1)
    lost = (bottle == 0).all(dim=1)
    through = ((bottle - behind).abs() < 0.02).all(dim=1)
    kept = (bottle == before[mask == BOTTLE].reshape(600, -1)).all(dim=1)
    assert torch.equal(lost.int() + through.int() + kept.int(), torch.ones(600, dtype=torch.int32))
    assert lost.float().mean() == pytest.approx(0.3, abs=0.06)
    assert through.float().mean() == pytest.approx(0.5, abs=0.06)
    # The sensor's noise lies on what is seen through it.
    apart = (bottle / behind - 1)[through]
    assert apart.std() == pytest.approx(0.002, rel=0.1)
    torch.manual_seed(0)
    assert torch.equal(clear_depth(inputs, 0.3, 0.5)[:, 0], found)
    assert torch.equal(clear_depth(inputs, 0.0, 0.0), inputs.depth)


def test_behind_pasted_glass_stands_what_it_hides() -> None:
    """An object of the frame's own behind a pasted one is seen, where a plane would be wrong."""
    inputs = frames(2)
    batch = dict(inputs.batch)
    for name in ("true", "mask"):
        batch[name] = batch[name].clone()
    batch["mask"][1] = batch["mask"][0].roll(60, dims=1)  # its bottle stands before the box
    batch["true"][1] = torch.where(batch["mask"][1] != BACKGROUND, 0.4, table())
    pasted = copy_paste(ModelInput(inputs.color, batch["true"][:, None], batch), 1.0)
    new = pasted.batch["mask"][0] == BOTTLE + 127
    while not new.any():  # half of the objects are taken
        pasted = copy_paste(ModelInput(inputs.color, batch["true"][:, None], batch), 1.0)
        new = pasted.batch["mask"][0] == BOTTLE + 127
    hidden = new & (batch["mask"][0] == BOX)
    assert hidden.sum() > 100
    found = clear_depth(pasted, 0.0, 1.0)[0, 0]
    assert (found[hidden] / 0.55 - 1).abs().max() < 0.02
    torch.manual_seed(3)
    turned = moved(pasted)
    shown = turned.batch["behind"] > 0
    share = shown.float().mean() / (pasted.batch["behind"] > 0).float().mean()
    assert 0.5 < share < 3
    assert (turned.batch["behind"] >= turned.batch["true"])[shown].float().mean() > 0.98


@pytest.mark.parametrize("name", CAUSES)
def test_every_cause_makes_holes_and_none_takes_all(
    name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    share = of_cause(name, monkeypatch).float().mean(dim=(1, 2))
    assert (share > 0).float().mean() > 0.6
    assert 0.002 < share.mean() < 0.6
    assert share.max() < 0.95


def test_causes_are_what_they_say(monkeypatch: pytest.MonkeyPatch) -> None:
    inputs = frames(24)
    true, mask = inputs.batch["true"], inputs.batch["mask"]
    with monkeypatch.context() as patch:
        band = of_cause("band", patch)
    sides = torch.stack([band[:, 0].all(1), band[:, -1].all(1), band[..., 0].all(1),
                         band[..., -1].all(1)], dim=1)  # fmt: skip
    assert (sides.sum(dim=1) >= 1).all()
    assert sides.any(dim=0).all()
    assert not band[:, H // 2, W // 2].any()
    with monkeypatch.context() as patch:
        cut = of_cause("range", patch)
    kept = ~cut
    for lost, left, depth in zip(cut, kept, true, strict=True):
        assert ((depth[lost] >= depth[left].max()) | (depth[lost] <= depth[left].min())).all()
    with monkeypatch.context() as patch:
        shadow = of_cause("shadow", patch)
    on_box = shadow & (mask == BOX)
    assert on_box.sum() == 0  # the nearest surface hides, and is not hidden
    beside = torch.zeros_like(shadow)
    beside[:, 28:72] = True
    assert (shadow & beside).sum() > 0.95 * shadow.sum()
    rows = shadow[:, 50]
    left, right = rows[:, 60:100].any(dim=1), rows[:, 130:].any(dim=1)
    assert left.any() and right.any()  # the other camera is to either side
    for name, sign in (("dark", -1), ("glossy", 1)):
        with monkeypatch.context() as patch:
            holed = of_cause(name, patch)
        grey = frames(24).color.mean(dim=1)
        assert sign * (grey[holed].mean() - grey[~holed].mean()) > 0.2
    with monkeypatch.context() as patch:
        shapes = of_cause("silhouettes", patch)
    sizes = {int(n) for n in shapes.flatten(1).sum(dim=1)}
    assert sizes <= {0, 800, 600, 1400}  # the bottle, the box, or both, whole
    assert (shapes & (mask == BACKGROUND)).sum() > 0.5 * shapes.sum()


def test_the_seed_and_the_share_decide() -> None:
    inputs = frames(200)
    found = []
    for seed in (3, 3, 4):
        torch.manual_seed(seed)
        found.append(cut_holes(inputs, 0.5))
    assert torch.equal(found[0], found[1])
    assert not torch.equal(found[0], found[2])
    changed = (found[0] != inputs.depth).flatten(1).any(dim=1).float().mean()
    # One of eight causes at least, each with 0.3, makes 0.94 of the chosen frames.
    assert changed == pytest.approx(0.5 * (1 - 0.7**8), abs=0.09)
    assert torch.equal(cut_holes(inputs, 0.0), inputs.depth)


def test_patches_are_evenly_distributed() -> None:
    torch.manual_seed(0)
    field = smooth_field(40, H, W, torch.device("cpu"))
    shares = [(field < level).float().mean().item() for level in (0.1, 0.5, 0.9)]
    assert shares == pytest.approx([0.1, 0.5, 0.9], abs=0.06)


def test_with_a_wrong_colour_the_continuation_is_the_answer() -> None:
    inputs = frames(100)
    depth = inputs.depth.clone()
    depth[:, :, 35:65, 45:55] = 0  # a hole in the bottle
    depth[:, :, 75:90, 70:100] = 0  # and one in the table
    holed = inputs._replace(depth=depth)
    torch.manual_seed(0)
    color, found, batch = wrong_color(holed, 0.5)
    changed = (color != inputs.color).flatten(1).any(dim=1)
    assert changed.float().mean() == pytest.approx(0.5, abs=0.15)
    other = torch.tensor([torch.equal(color[i], inputs.color[i - 1]) for i in range(100)])
    assert 0.25 < other[changed].float().mean() < 0.75 and not other[~changed].any()
    assert torch.equal(found, depth)
    for name in ("true", "mask"):
        assert torch.equal(batch[name][~changed], inputs.batch[name][~changed])
    # In the table the table; in the bottle what was measured around the hole.
    wanted = batch["true"][changed]
    assert (wanted - table())[:, 75:90, 70:100].abs().max() < 3e-3
    assert (wanted - 0.6)[:, 35:65, 45:55].abs().max() < 5e-3
    right = (depth[changed, 0] > 0) & (
        (depth[changed, 0] - inputs.batch["true"][changed]).abs() < 3e-3
    )
    assert torch.equal(wanted[right], inputs.batch["true"][changed][right])
    assert not (batch["mask"][changed] == BOTTLE).any()
    assert (batch["mask"][changed] == BOX).sum() == 600 * changed.sum()
    torch.manual_seed(0)
    assert torch.equal(wrong_color(holed, 0.5).batch["true"], batch["true"])
    one = frames(1)
    assert not torch.equal(wrong_color(one, 1.0).color, one.color)  # noise: there is no other
    empty = one._replace(depth=0 * one.depth)
    assert (wrong_color(empty, 1.0).batch["true"] == 0).all()


def test_a_continuation_is_harmonic_in_inverse_depth() -> None:
    true = table()[None]
    known = torch.ones_like(true, dtype=torch.bool)
    known[:, 20:80, 30:130] = False
    found = continued(true, known)
    assert torch.equal(found[known], true[known])
    assert (found / true - 1).abs().max() < 0.01  # in a hole over four tenths of the image
    # Nothing is nearer or farther than its surroundings.
    rng = np.random.default_rng(0)
    rough = torch.from_numpy(rng.uniform(0.5, 1.0, (2, 31, 47)).astype(np.float32))
    sparse = torch.from_numpy(rng.random((2, 31, 47)) < 0.02)
    found = continued(rough, sparse)
    assert found.min() >= rough[sparse].min() - 1e-6
    assert found.max() <= rough[sparse].max() + 1e-6


def test_shares_of_the_same_objects_add_up_to_one_at_most() -> None:
    with pytest.raises(ToolkitError, match="clear-gone"):
        TrainOptions(method="dfnet", data=(), clear_gone=0.7, clear_behind=0.4)
