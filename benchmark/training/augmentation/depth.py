"""Augmentation of the sensor's depth on objects, and frames whose colour is wrong.

In the depth maps of a simulator a hole is an object, and glass shows in them. Here objects lose
their depth, or show the surface behind them as if they were not there, so that colour alone tells
where they are; and where colour tells nothing, the answer is the smooth continuation of what was
measured.
"""

import torch
from torch import Tensor
from torch.nn.functional import avg_pool2d, interpolate

from benchmark.data.frame import BACKGROUND, Material
from benchmark.methods.depth.continuation import relaxed
from benchmark.metrics.depth.figures import CLOSE_M, CLOSE_SHARE
from benchmark.training.augmentation.holes import smooth_field
from benchmark.training.step import ModelInput, made_of

# Chances that the depth of an object is replaced, in a frame with such objects.
_DROPOUT_CLEAR, _DROPOUT_OPAQUE = 0.6, 0.15
# Ways of it, as limits of a uniform draw: no depth, specks, background, true depth, then patches.
_WAYS = (0.25, 0.4, 0.65, 0.75)
_PATCH_LIMITS = (0.35, 0.7)  # background below, no depth above, else as the sensor has it
_SPECKS = 0.1  # largest share of missing readings beside the way "specks"
_NOISE = 0.002  # relative

_GROWN_PX = 2  # by at most this many pixels more than the object is without depth

_SWEEPS = 6  # of the continuation at each size: the next coarser size begins near the solution

# Relative deviation from the support plane at which a pixel counts half in its fit.
_OFF_PLANE = 0.02

# Largest deviations of the sensor's noise at 1 m, metres: of pixels, and of patches of a size.
_PIXEL_NOISE_M, _PATCH_NOISE_M, _NOISE_PX = 0.0015, 0.003, 10

_NOISY = 0.5  # share of the frames of a wrong colour that have noise; others another frame's


@torch.no_grad()
def drop_object_depth(
    depth: Tensor,
    true: Tensor,
    mask: Tensor,
    materials: Tensor,
    share: float,
    scene: Tensor | None = None,
) -> Tensor:
    """Sensor depth in which that of some objects is replaced, in a share of the frames.

    Each such object has no depth at all, no depth in specks, the depth of what is behind it, its
    true depth, or patches of all of these. Glass and metal are chosen more often than the others.

    Args:
        depth: (b, 1, h, w) metres, 0 = none.
        true: (b, h, w) exact depth, 0 = none.
        mask: (b, h, w) uint8 instance ids, 255 elsewhere.
        materials: (b, 256) `Material` of each instance, 255 = none.
        share: of the frames.
        scene: (b, h, w) what `without_objects` gives, if that is known.
    """
    b, _, h, w = depth.shape
    on = depth.device
    clear = (materials == Material.SPECULAR) | (materials == Material.TRANSPARENT)
    hit = torch.rand(b, 256, device=on) < torch.where(clear, _DROPOUT_CLEAR, _DROPOUT_OPAQUE)
    hit &= torch.rand(b, 1, device=on) < share
    hit[:, 255] = False

    def of_objects(values: Tensor) -> Tensor:
        return values.gather(1, mask.flatten(1).long()).reshape(b, h, w)

    objects = of_objects(hit)
    if not objects.any():
        return depth
    way = of_objects(torch.rand(b, 256, device=on))
    patches = smooth_field(b, h, w, on)
    gone, specks, behind, measured = (way < limit for limit in _WAYS)
    patched = ~measured
    measured, behind = measured & ~behind, behind & ~specks
    specks = specks & ~gone
    behind = behind | (patched & (patches < _PATCH_LIMITS[0]))
    gone = gone | (patched & (patches > _PATCH_LIMITS[1]))
    # Readings are missing here and there in every case, by a share of the object's own.
    missing = torch.rand(b, h, w, device=on) < torch.where(specks, 1.0, _SPECKS) * of_objects(
        torch.rand(b, 256, device=on)
    )
    errors = 1 + _NOISE * torch.randn(b, h, w, device=on)
    found = torch.where(measured, true * errors, depth[:, 0])
    if scene is None:
        scene = without_objects(true, mask != BACKGROUND)
    found = torch.where(behind, scene * errors, found)
    found = found.masked_fill(gone | missing, 0.0)
    return torch.where(objects, found, depth[:, 0])[:, None]


@torch.no_grad()
def clear_depth(
    inputs: ModelInput, gone: float, behind: float, scene: Tensor | None = None
) -> Tensor:
    """Sensor depth in which whole glass and metal objects are missing, or are seen through.

    Args:
        inputs: frames with `true`, `mask` and `materials`, and `behind` if objects were pasted.
        gone: share of these objects without any depth, up to two pixels around them, too.
        behind: share in whose place the surfaces behind stand whole, with the sensor's noise. The
            scene without them is known where they were pasted; elsewhere it is the support plane
            and what lies around it, continued. The other objects keep what the sensor has.
        scene: (b, h, w) what `without_objects` gives, if that is known.

    Returns:
        (b, 1, h, w) metres, 0 = none.
    """
    batch, depth = inputs.batch, inputs.depth
    mask, true = batch["mask"], batch["true"]
    b, h, w = mask.shape
    on = depth.device
    clear = (batch["materials"] == Material.SPECULAR) | (batch["materials"] == Material.TRANSPARENT)
    clear[:, BACKGROUND] = False
    draw = torch.rand(b, 256, device=on)
    ids = mask.flatten(1).long()

    def of_objects(table: Tensor) -> Tensor:
        return (table & clear).gather(1, ids).reshape(b, h, w)

    lost, seen_through = (
        of_objects(draw < gone),
        of_objects((draw >= gone) & (draw < gone + behind)),
    )
    found = depth[:, 0]
    if seen_through.any():
        if scene is None:
            scene = without_objects(true, mask != BACKGROUND)
        if "behind" in batch:
            scene = torch.where(batch["behind"] > 0, batch["behind"], scene)
        # What is behind is not in front, whatever the continuation says.
        scene = torch.maximum(scene, true)
        errors = 1 + _NOISE * torch.randn(b, h, w, device=on)
        found = torch.where(seen_through & (true > 0), scene * errors, found)
    if lost.any():
        reach = int(torch.randint(_GROWN_PX + 1, ()))
        grown = _grown(lost, reach) & ~seen_through
        found = found.masked_fill(grown, 0.0)
    return found[:, None]


def _grown(pixels: Tensor, reach: int) -> Tensor:
    """(b, h, w) pixels and those at most `reach` away, along rows and columns."""
    if not reach:
        return pixels
    size = 2 * reach + 1
    return torch.nn.functional.max_pool2d(pixels[:, None].float(), size, 1, reach)[:, 0] > 0


@torch.no_grad()
def with_noise(depth: Tensor, share: float) -> Tensor:
    """(b, 1, h, w) sensor depth with the noise of stereo in a share of the frames.

    Noise of the disparity, of single pixels and of patches, moves depth by its square.
    """
    b, _, h, w = depth.shape
    on = depth.device
    strength = torch.rand(2, b, 1, 1, device=on) * (torch.rand(b, 1, 1, device=on) < share)
    pixels = _PIXEL_NOISE_M * strength[0] * torch.randn(b, h, w, device=on)
    patches = _PATCH_NOISE_M * strength[1] * (2 * smooth_field(b, h, w, on, _NOISE_PX) - 1)
    return (depth + (pixels + patches)[:, None] * depth.square()).clamp(min=0.0)


@torch.no_grad()
def wrong_color(inputs: ModelInput, share: float) -> ModelInput:
    """A share of the frames with noise or another frame's colour, which says nothing of the scene.

    The answer is then what a filling makes of the depth alone: the sensor's depth, exact where the
    sensor was right, and its smooth continuation in the holes. No pixel of glass or metal is
    labelled in these frames.

    Args:
        inputs: augmented frames; `inputs.depth` is what the network gets.
        share: of the frames.
    """
    color, depth, batch = inputs.color, inputs.depth, dict(inputs.batch)
    b = len(depth)
    chosen = (torch.rand(b) < share).nonzero()[:, 0].to(depth.device)
    if not len(chosen):
        return inputs
    others = color[(chosen - 1) % b]
    noisy = torch.rand(len(chosen), 1, 1, 1, device=depth.device) < (_NOISY if b > 1 else 1.0)
    strange = torch.where(noisy, torch.rand_like(others), others)
    sensor, true = depth[chosen, 0], batch["true"][chosen]
    allowed = (CLOSE_SHARE * true).clamp(min=CLOSE_M)
    right = (sensor > 0) & (true > 0) & ((sensor - true).abs() <= allowed)
    known = torch.where(right, true, sensor)
    some = (sensor > 0).flatten(1).any(dim=1)  # without any depth there is nothing to continue
    wanted = torch.where(some[:, None, None], continued(known, known > 0), 0.0)
    tables = {name: batch[name][chosen] for name in ("mask", "materials")}
    clear = made_of(tables, Material.TRANSPARENT, Material.SPECULAR)
    batch["true"] = batch["true"].index_copy(0, chosen, wanted)
    unlabelled = tables["mask"].masked_fill(clear, BACKGROUND)
    batch["mask"] = batch["mask"].index_copy(0, chosen, unlabelled)
    if "nocs" in batch:
        nocs = batch["nocs"][chosen].masked_fill(clear[..., None], 0)
        batch["nocs"] = batch["nocs"].index_copy(0, chosen, nocs)
    return ModelInput(color.index_copy(0, chosen, strange.to(color.dtype)), depth, batch)


def without_objects(true: Tensor, objects: Tensor) -> Tensor:
    """The exact depth of a scene as if objects were not there.

    Inverse depth is affine in the pixels of a plane. A plane is fitted to it outside of the
    objects, by least squares in which pixels far off count little; what the scene deviates from it
    is continued smoothly from the outlines into the objects.

    Args:
        true: (b, h, w) metres, 0 = none.
        objects: (b, h, w) bool pixels to look through.

    Returns:
        (b, h, w) metres; unchanged outside, 0 in frames without anything outside.
    """
    known = (true > 0) & ~objects
    inverse = torch.where(known, 1 / true.clamp(min=1e-6), 0.0)
    plane = _plane(inverse, known)
    # What is continued is smooth: at a quarter of the size it takes a sixteenth of the time.
    weight = _smaller(known.to(inverse.dtype))
    means = _smaller((inverse - plane) * known) / weight.clamp(min=1e-6)
    apart = continued_field(means, weight > 0)[:, None]
    # Cells of 4x4 pixels: those beyond the last whole one belong to it.
    h, w = true.shape[1:]
    size = (4 * apart.shape[2], 4 * apart.shape[3])
    apart = interpolate(apart, size, mode="bilinear", align_corners=False)[:, 0, :h, :w]
    low = inverse.flatten(1).amax(dim=1).clamp(min=1e-6) / 20  # beyond all that is there
    found = 1 / torch.maximum(plane + apart, low[:, None, None])
    found = torch.where(known.flatten(1).any(dim=1)[:, None, None], found, 0.0)
    return torch.where(objects, found, true)


def _smaller(values: Tensor) -> Tensor:
    """(b, h, w) means over cells of 4x4 pixels."""
    return avg_pool2d(values[:, None], 4, ceil_mode=True)[:, 0]


def _plane(inverse: Tensor, known: Tensor) -> Tensor:
    """(b, h, w) a u + b v + c fitted to the inverse depth of whole cells, robustly."""
    b, h, w = inverse.shape
    v = torch.linspace(-1, 1, h, device=inverse.device)[:, None]
    u = torch.linspace(-1, 1, w, device=inverse.device)[None]
    rows, columns = h // 4, w // 4

    def cells(values: Tensor) -> Tensor:
        return avg_pool2d(values[:, None], 4)[:, 0, :rows, :columns].reshape(len(values), -1)

    values, weights = cells(inverse), (cells(known.to(inverse.dtype)) > 0.999).to(inverse.dtype)
    whole = weights
    at = torch.stack([u.expand(h, w), v.expand(h, w), torch.ones_like(inverse[0])])
    terms = cells(at).T
    squares = (terms[:, :, None] * terms[:, None]).reshape(-1, 9)
    ridge = 1e-6 * torch.eye(3, device=inverse.device, dtype=inverse.dtype)
    solved = values.new_zeros(b, 3)
    for _ in range(4):
        total = weights.sum(dim=1).clamp(min=1)
        normal = (weights @ squares).reshape(b, 3, 3) / total[:, None, None] + ridge
        right = (weights * values) @ terms / total[:, None]
        solved = torch.linalg.solve(normal, right[..., None])[..., 0]
        off = (values / (solved @ terms.T).clamp(min=1e-6) - 1) / _OFF_PLANE
        weights = whole / (1 + off * off)
    return solved[:, 0, None, None] * u + solved[:, 1, None, None] * v + solved[:, 2, None, None]


def continued(depth: Tensor, known: Tensor) -> Tensor:
    """Depth continued smoothly, in inverse depth, from known pixels into all others.

    Args:
        depth: (b, h, w) metres.
        known: (b, h, w) bool pixels to continue from.

    Returns:
        (b, h, w) metres.
    """
    inverse = torch.where(known, 1 / depth.clamp(min=1e-6), 0.0)
    found = 1 / continued_field(inverse, known).clamp(min=1e-6)
    return torch.where(known, depth, found)


def continued_field(values: Tensor, known: Tensor) -> Tensor:
    """Values continued harmonically (their Laplacian is 0) from known pixels into all others.

    Args:
        values: (b, h, w).
        known: (b, h, w) bool.

    Returns:
        (b, h, w); values unchanged at known pixels, 0 in frames without any.
    """
    weight = known.to(values.dtype)[:, None]
    return relaxed(values[:, None], weight, lambda sure: (sure > 0).to(sure.dtype), _SWEEPS)[:, 0]
