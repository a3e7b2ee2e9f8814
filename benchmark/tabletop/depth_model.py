"""A fast approximation of the simulated depth camera: exact depth with fitted errors.

Every pixel gets one of four labels: not measured, the surface itself, the surface behind it (at an
edge or in a shadow: the other side of the edge), or a wrong distance. The fractions of the labels
are sampled for each object by its material class, for the table, for edges and for the strip that
only one infrared camera sees. Labels form patches as large as those of the simulator. The
parameters were fitted to frames of `std-sim` (`perf/clearing_depth.py` fits and compares them). The
limits of the model are listed in docs/grasping.md.
"""

from collections.abc import Mapping
from functools import cache
from pathlib import Path

import cv2
import msgspec
import numpy as np
from numpy.typing import NDArray

from benchmark.data.frame import BACKGROUND
from std_toolkit.geometry.camera import Camera
from std_toolkit.io.documents import decode_document

MODEL_FILE = Path(__file__).with_name("depth_model.json")
Floats = NDArray[np.float64]
# The labels, in the order of `KindModel.shares`.
SURFACE, OTHER, WRONG, HOLE = range(4)
LABELS = ("surface", "other", "wrong", "hole")
MATERIALS = ("raw", "diffuse", "transparent", "specular")
TABLE, EDGE, SHADOW = "table", "edge", "shadow"
KINDS = (*MATERIALS, TABLE, EDGE, SHADOW)
# Smallest step in depth that is an edge, and the range of its influence.
STEP_M, EDGE_PX = 0.015, 3
# Half the matching window: pixels closer to the image border are not measured.
BORDER_PX = 5
# Quantiles of the stored wrong distances.
LEVELS = np.linspace(0.02, 0.98, 25)


class KindModel(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Depth error model of one kind of pixels.

    Attributes:
        instances: number of objects (frames, for table, edges and shadows) in the fit.
        shares: mean fractions of the labels, in the order of `LABELS`; their sum is 1.
        concentration: concentration of the Dirichlet distribution of the fractions of one object;
            large values mean little variation.
        patch_px: standard deviation of the Gaussian filter that forms patches of labels.
        bias_m: median error where the surface is measured.
        noise_px: standard deviation of the disparity there.
        wrong_m: error of the wrong distances at the quantiles `LEVELS`.
    """

    instances: int
    shares: list[float]
    concentration: float
    patch_px: float
    bias_m: float
    noise_px: float
    wrong_m: list[float]


class DepthModel(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """The whole model.

    Attributes:
        source: data and program of the fit.
        focal_baseline: focal length in pixels times the baseline in metres in the fit.
        kinds: models by `KINDS`.
    """

    source: str
    focal_baseline: float
    kinds: dict[str, KindModel]


@cache
def load_depth_model() -> DepthModel:
    """Load the fitted parameters that ship with the toolkit."""
    data = MODEL_FILE.read_bytes()
    return decode_document(data, DepthModel)


def pixel_kinds(
    depth: NDArray[np.float32],
    mask: NDArray[np.uint8],
    behind: NDArray[np.float32],
    material_of: Mapping[int, str],
    *,
    focal_baseline: float,
) -> tuple[NDArray[np.uint8], NDArray[np.float32]]:
    """Return the kind of every pixel, and for edges and shadows the depth of the other side.

    Glass has no edges and shadows: the infrared cameras see the pattern behind it.

    Args:
        depth: (h, w) exact depth.
        mask: (h, w) object of each pixel, `BACKGROUND` on the table.
        behind: (h, w) depth behind the object of each pixel.
        material_of: material class of each object.
        focal_baseline: focal length times baseline of the camera, pixels times metres.

    Returns:
        (h, w) index in `KINDS`, and (h, w) float32 metres, valid only for edges and shadows.
    """
    kinds = np.full(depth.shape, KINDS.index(TABLE), np.uint8)
    for index, material in material_of.items():
        kinds[mask == index] = KINDS.index(material)
    glass = kinds == KINDS.index("transparent")
    depth = np.where(glass, behind, depth)
    around = np.ones((2 * EDGE_PX + 1,) * 2, np.uint8)
    near, far = cv2.erode(depth, around), cv2.dilate(depth, around)
    # On a slanted table depth changes within the window without a step.
    slope = np.abs(cv2.Laplacian(depth, cv2.CV_32F, ksize=1))
    step = cv2.dilate((slope > STEP_M / 2).astype(np.uint8), around) > 0
    edge = step & (far - near > STEP_M)
    other = np.where(depth - near > far - depth, near, far).astype(np.float32)
    shadow = _shadow(depth, focal_baseline)
    kinds[edge & ~glass] = KINDS.index(EDGE)
    kinds[shadow & ~glass] = KINDS.index(SHADOW)
    return kinds, other


def unmatched(depth: NDArray[np.float32], focal_baseline: float) -> NDArray[np.bool_]:
    """Return the (h, w) mask of pixels outside the right infrared image or at a border, where depth
    is not measured."""
    h, w = depth.shape
    disparity = focal_baseline / np.maximum(depth, 1e-3)
    u, v = np.arange(w)[None], np.arange(h)[:, None]
    side = (v < BORDER_PX) | (v >= h - BORDER_PX) | (u >= w - BORDER_PX)
    return side | (u - disparity < BORDER_PX)


def _shadow(depth: NDArray[np.float32], focal_baseline: float) -> NDArray[np.bool_]:
    """Pixels of the left infrared camera that are occluded in the right one: a point of larger
    disparity is at the same pixel."""
    h, w = depth.shape
    disparity = focal_baseline / np.maximum(depth, 1e-3)
    there = np.rint(np.arange(w) - disparity).astype(np.int64)
    rows = np.broadcast_to(np.arange(h)[:, None], there.shape)
    inside = there >= 0
    front = np.zeros((h, w))
    np.maximum.at(front, (rows[inside], there[inside]), disparity[inside])
    seen = front[rows, np.maximum(there, 0)]
    # Half a pixel of rounding on each side.
    return inside & (disparity < seen - 1.0)


def degrade(
    depth: NDArray[np.float32],
    mask: NDArray[np.uint8],
    behind: NDArray[np.float32],
    material_of: Mapping[int, str],
    camera: Camera,
    *,
    rng: np.random.Generator,
    shares: Mapping[int, Floats] | None = None,
    model: DepthModel | None = None,
) -> NDArray[np.float32]:
    """Return the measured depth.

    Args:
        depth: (h, w) float32 metres, exact.
        mask: (h, w) object of each pixel, `BACKGROUND` on the table.
        behind: (h, w) float32 metres, depth behind the object of each pixel.
        material_of: material class of each object.
        camera: camera of these maps.
        rng: random generator; its state changes.
        shares: label fractions of each object, from `draw_shares`; sampled here by default.
        model: model; by default the fitted one.

    Returns:
        (h, w) float32 metres, 0 where not measured.
    """
    model = model or load_depth_model()
    # The baseline is that of the fit, the focal length that of the camera.
    focal_baseline = camera.fx * model.focal_baseline / FITTED_FX
    kinds, other = pixel_kinds(depth, mask, behind, material_of, focal_baseline=focal_baseline)
    if shares is None:
        shares = {i: draw_shares(m, rng, model) for i, m in material_of.items()}
    measured = np.zeros_like(depth)
    matched = ~unmatched(depth, focal_baseline)
    regions = [
        (kind, kinds == KINDS.index(kind), draw_shares(kind, rng, model))
        for kind in (TABLE, EDGE, SHADOW)
    ]
    regions += [
        (material, (mask == index) & (kinds == KINDS.index(material)), shares[index])
        for index, material in material_of.items()
    ]
    for kind, everywhere, share in regions:
        here = everywhere & matched
        alternative = other if kind in (EDGE, SHADOW) else behind
        measured[here] = _measured(
            depth, alternative, here, share, model.kinds[kind], focal_baseline, rng
        )
    return measured


FITTED_FX = 301.07
"""Focal length in pixels of the frames in the fit."""


def draw_shares(kind: str, rng: np.random.Generator, model: DepthModel | None = None) -> Floats:
    """Sample the label fractions (4,) of one object (or one view of table, edges and shadows)."""
    fitted = (model or load_depth_model()).kinds[kind]
    return rng.dirichlet(np.maximum(np.array(fitted.shares), 1e-4) * fitted.concentration)


def _measured(
    depth: NDArray[np.float32],
    other: NDArray[np.float32],
    here: NDArray[np.bool_],
    share: Floats,
    fitted: KindModel,
    focal_baseline: float,
    rng: np.random.Generator,
) -> NDArray[np.float32]:
    """Depth at the pixels `here`."""
    field = patches(depth.shape, fitted.patch_px, rng)[here]
    slip = patches(depth.shape, fitted.patch_px, rng)[here]
    jitter = patches(depth.shape, 1.0, rng)[here]
    if not len(field):
        return np.zeros(0, np.float32)
    # Ranks instead of values: the fractions then hold in every region, even if small.
    rank = np.argsort(np.argsort(field, kind="stable"), kind="stable") / len(field)
    label = np.searchsorted(np.cumsum(share)[:-1], rank, side="right")
    own, behind = depth[here].astype(np.float64), other[here].astype(np.float64)
    level = np.argsort(np.argsort(slip, kind="stable"), kind="stable") / len(slip)
    base = np.select(
        [label == SURFACE, label == OTHER, label == WRONG],
        [own + fitted.bias_m, behind, own + np.interp(level, LEVELS, fitted.wrong_m)],
        default=0.0,
    )
    noise = jitter * fitted.noise_px * base**2 / focal_baseline
    found = np.where(label == HOLE, 0.0, base + noise)
    return np.where(found > 0.1, found, 0.0).astype(np.float32)


def patches(shape: tuple[int, ...], sigma: float, rng: np.random.Generator) -> Floats:
    """Return (h, w) Gaussian noise of deviation 1, correlated over about `sigma` pixels."""
    noise = rng.standard_normal(shape)
    if sigma < 0.3:
        return noise
    smooth = cv2.GaussianBlur(noise, (0, 0), sigma, borderType=cv2.BORDER_REFLECT)
    return smooth * (2 * np.sqrt(np.pi) * sigma)


__all__ = [
    "BACKGROUND",
    "DepthModel",
    "KindModel",
    "degrade",
    "draw_shares",
    "load_depth_model",
    "patches",
    "pixel_kinds",
]
