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
    from benchmark.training.augmentation import ColorAugmentation

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
    from benchmark.training.augmentation import ColorAugmentation

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
    from benchmark.training import augmentation
    from benchmark.training.augmentation import ColorAugmentation

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
    from benchmark.training import augmentation

    images = colors(30)
    torch.manual_seed(1)
    changed = augmentation._bright_patches(images)
    assert (changed >= images - 1e-6).all()
    share = ((changed - images).abs().amax(dim=1) > 1e-3).float().mean().item()
    assert 0.1 < share < 0.9


def test_coarse_gaps_are_about_two_percent():
    from benchmark.training import augmentation

    torch.manual_seed(0)
    white = torch.ones(64, 3, 64, 64)
    shares = torch.stack([1 - augmentation._coarse_gaps(white).mean() for _ in range(10)])
    assert shares.mean().item() == pytest.approx(0.02, abs=0.008)


def test_objects_lose_depth_and_the_background_does_not():
    from benchmark.training.augmentation import lose_objects

    depth = torch.full((40, 1, 20, 20), 0.7)
    mask = torch.full((40, 20, 20), 255, dtype=torch.uint8)
    mask[:, 2:8, 2:8] = 1
    mask[:, 10:18, 10:18] = 4
    torch.manual_seed(0)
    lost = lose_objects(depth, mask, 0.5) == 0
    assert not lost[:, 0][mask == 255].any()
    hit = lost.flatten(1).any(dim=1).float().mean().item()
    # Half of the frames, less those of which no object is drawn.
    assert 0.2 < hit < 0.55
    one = lost[:, 0, 2:8, 2:8].flatten(1).float().mean(dim=1)
    assert (one[one > 0] < 1).any(), "objects lose a share of their pixels"
    assert not (lose_objects(depth, mask, 0.0) == 0).any()
