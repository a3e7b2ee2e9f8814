"""Augmentation: shares and sizes of the changes, and that depth is left alone unless asked for."""

from __future__ import annotations

import pytest
import torch


def colors(count: int, side: int = 32, seed: int = 0) -> torch.Tensor:
    draw = torch.Generator().manual_seed(seed)
    coarse = torch.rand(count, 3, 4, 4, generator=draw) * 0.6 + 0.2
    return torch.nn.functional.interpolate(coarse, size=(side, side), mode="bilinear")


@pytest.mark.slow
def test_images_stay_images_and_each_gets_its_own_change():
    from benchmark.training.augmentation.color import ColorAugmentation

    images = colors(200)
    torch.manual_seed(0)
    changed = ColorAugmentation()(images)
    assert changed.shape == images.shape
    assert changed.dtype == images.dtype
    assert torch.isfinite(changed).all()
    assert changed.min() >= 0
    assert changed.max() <= 1
    apart = (changed - images).abs().amax(dim=(1, 2, 3))
    # 0.9 * 0.7 * 0.8 * 0.8 of the images are left as they are.
    assert (apart < 1e-6).float().mean().item() == pytest.approx(0.4, abs=0.12)
    assert len(apart[apart > 1e-6].unique()) > 50


def test_the_seed_alone_decides():
    from benchmark.training.augmentation.color import ColorAugmentation

    images = colors(24)
    change = ColorAugmentation()
    found = []
    for seed in (3, 3, 4):
        torch.manual_seed(seed)
        found.append(change(images))
        torch.rand(17)  # what others draw in between
    assert torch.equal(found[0], found[1])
    assert not torch.equal(found[0], found[2])


def test_every_single_change_changes_and_stays_in_range():
    from benchmark.training.augmentation import color as augmentation
    from benchmark.training.augmentation.color import ColorAugmentation

    change = ColorAugmentation()
    images = colors(8)
    singles = [*change.tones, *change.blurs, *change.noises]
    singles += [augmentation._bright_patches, augmentation._coarse_gaps]
    for number, single in enumerate(singles):
        torch.manual_seed(number)
        changed = single(images)
        assert changed.shape == images.shape, number
        assert changed.min() >= -1e-6, number
        assert changed.max() <= 1 + 1e-6, number
        assert (changed - images).abs().max() > 1e-4, number
        # None makes another picture of it.
        assert (changed - images).abs().mean() < 0.35, number


def test_bright_patches_only_brighten():
    from benchmark.training.augmentation import color as augmentation

    images = colors(30)
    torch.manual_seed(1)
    changed = augmentation._bright_patches(images)
    assert (changed >= images - 1e-6).all()
    share = ((changed - images).abs().amax(dim=1) > 1e-3).float().mean().item()
    assert 0.1 < share < 0.9


def test_coarse_gaps_are_about_two_percent():
    from benchmark.training.augmentation import color as augmentation

    torch.manual_seed(0)
    white = torch.ones(64, 3, 64, 64)
    shares = torch.stack([1 - augmentation._coarse_gaps(white).mean() for _ in range(10)])
    assert shares.mean().item() == pytest.approx(0.02, abs=0.008)


def test_objects_are_measured_otherwise_and_the_background_is_not():
    from benchmark.data.frame import Material
    from benchmark.training.augmentation.depth import drop_object_depth

    b = 400
    slope = torch.linspace(0.9, 1.1, 48).expand(b, 32, 48)
    mask = torch.full((b, 32, 48), 255, dtype=torch.uint8)
    mask[:, 8:24, 4:16], mask[:, 8:24, 28:44] = 1, 4
    materials = torch.full((b, 256), 255, dtype=torch.uint8)
    materials[:, 1], materials[:, 4] = Material.TRANSPARENT, Material.DIFFUSE
    true = torch.where(mask == 255, slope, 0.7)
    depth = torch.where(mask == 1, 0.5, true)[:, None]  # the sensor is wrong on glass
    torch.manual_seed(0)
    found = drop_object_depth(depth, true, mask, materials, 1.0)[:, 0]
    changed = found != depth[:, 0]
    assert not changed[mask == 255].any()
    glass, wood = (
        (changed & (mask == number)).flatten(1).any(dim=1).float().mean().item()
        for number in (1, 4)
    )
    assert 0.5 < glass < 0.7 and 0.08 < wood < 0.25
    # Each way occurs on glass: nothing, the background, the truth, what the sensor says.
    glass_depth = found[:, 8:24, 4:16].flatten(1)
    behind = slope[:, 8:24, 4:16].flatten(1)
    for share, of in (
        ((glass_depth == 0).float().mean(dim=1), 0.95),
        (((glass_depth - behind).abs() < 0.03).float().mean(dim=1), 0.85),
        (((glass_depth - 0.7).abs() < 0.01).float().mean(dim=1), 0.85),
    ):
        assert 0.03 < (share > of).float().mean() < 0.3
    patched = (glass_depth == 0.5).any(dim=1) & (glass_depth > 0.8).any(dim=1)
    assert patched.float().mean() > 0.05
    again = drop_object_depth(depth, true, mask, materials, 0.0)
    assert torch.equal(again, depth)
    torch.manual_seed(0)
    assert torch.equal(drop_object_depth(depth, true, mask, materials, 1.0)[:, 0], found)
