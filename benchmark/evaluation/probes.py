"""What a user sees of a restorer: harm, trust, holes elsewhere, dependence on colour.

Harm and trust are figures of the answer that is scored. The probes run the method again on changed
views: `holes` on depth in which holes are cut, `color` on noise and on another frame's colour, as
the sensor's depth is and with all depth of glass and metal removed.
"""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import replace
from hashlib import blake2b
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from benchmark.data.frame import BACKGROUND, DepthFrame, Material, Size, T, resize_nearest
from benchmark.evaluation.frames import restore_views
from benchmark.methods.depth.filling.filler import fill_nearest
from benchmark.methods.depth.full_size import restorer_view, to_full_size, working_size
from benchmark.methods.protocol import Restored, Restorer, View
from benchmark.metrics.depth import harm, holes, trust
from benchmark.metrics.protocols.protocol import HARD, Protocol, Subset
from benchmark.metrics.protocols.score import score_depth
from std_toolkit.arrays import Floats, Mask
from std_toolkit.geometry.camera import Camera
from std_toolkit.html.table import Column

# What a frame of a recording is to the self-supervised test: name, colour, depth, camera.
Recorded = tuple[str, NDArray[np.uint8], Floats, Camera]
Restore = Callable[[NDArray[np.uint8], Floats, Camera], NDArray[np.floating]]


def _color(name: str, heading: str) -> Column:
    return Column(name=name, heading=heading, unit="mm", factor=1e3, lower_is_better=None)


COLORS = (
    _color("color_true", "RMSE on glass and metal"),
    _color("color_noise", "with noise as colour"),
    _color("color_other", "with another frame's colour"),
    _color("bare_true", "without depth on glass and metal"),
    _color("bare_noise", "without depth, noise"),
    _color("bare_other", "without depth, another frame's"),
)

ALWAYS = (*harm.NAMES, *trust.NAMES)
SPREAD_COLUMNS = trust.COLUMNS
COLUMNS = (*harm.COLUMNS, *holes.COLUMNS, *COLORS, *trust.COLUMNS)
NAMES = (*ALWAYS, *holes.NAMES, *(column.name for column in COLORS))


def _at(image: NDArray[T], size: Size) -> NDArray[T]:
    """An image at a size; the image itself if it has that size."""
    return image if (image.shape[1], image.shape[0]) == size else resize_nearest(image, size)


def seen_size(restorer: Restorer, frame: DepthFrame, protocol: Protocol) -> Size:
    """(width, height) of what a user sees.

    The sensor's, as `std-restore` writes it, for a method with an image size of its own; others,
    saved depth too, answer at the size of their view.
    """
    sensor = frame.depth_raw.shape[1], frame.depth_raw.shape[0]
    if working_size(restorer, sensor) is None:
        return protocol.view_size or frame.camera.size
    return sensor


def as_seen(
    restorer: Restorer, sensor: Floats, answer: Restored | str, color: NDArray[np.uint8]
) -> Floats:
    """The depth that a user gets.

    Args:
        restorer: that answered.
        sensor: (H, W) metres, of `seen_size`.
        answer: at the size of the method's view; a text if the method failed.
        color: (h, w, 3) uint8 RGB of any size.

    Returns:
        (H, W) metres, 0 without an answer.
    """
    if isinstance(answer, str):
        return np.zeros_like(sensor)
    size = (sensor.shape[1], sensor.shape[0])
    if working_size(restorer, size) is None:
        found = _at(answer.depth, size)
        return np.where(np.isfinite(found) & (found > 0), found, 0).astype(np.float32)
    if (color.shape[1], color.shape[0]) != size:
        color = cv2.resize(color, size, interpolation=cv2.INTER_AREA)  # type: ignore[assignment]
    return to_full_size(sensor, answer, color).depth


def answer_figures(
    restorer: Restorer,
    frame: DepthFrame,
    sensor: Floats,
    answer: Restored | str,
    protocol: Protocol,
) -> dict[str, float]:
    """Harm and trust of an answer.

    Args:
        restorer: that answered.
        frame: what was there.
        sensor: (h, w) the sensor's own metres; `frame.depth_raw` may be saved depth instead.
        answer: a text if the method failed: every pixel is missing.
        protocol: whose view size holds.

    Returns:
        Figures by the names of `ALWAYS`; NaN where there is nothing to tell, such as of trust
        without a spread.
    """
    found = dict.fromkeys(ALWAYS, float("nan"))
    if not sensor.size:
        return found
    measured = _at(sensor, seen_size(restorer, frame, protocol))
    true, clear, objects = _truth(frame, measured.shape)
    seen = as_seen(restorer, measured, answer, frame.color)
    found |= harm.harm_by_region(seen, measured, true, clear, objects)
    if isinstance(answer, str) or answer.spread is None:
        return found
    size = (answer.depth.shape[1], answer.depth.shape[0])
    true, clear, objects = _truth(frame, answer.depth.shape)
    glass = _at(frame.mask_of(Material.TRANSPARENT), size)
    regions = {
        "glass": glass,
        "metal": clear & ~glass,
        "opaque": objects & ~clear,
        "background": ~objects,
        "filled": (_at(sensor, size) == 0) & ~clear,
    }
    return found | trust.trust_figures(answer.depth, answer.spread, true, regions)


def _truth(frame: DepthFrame, shape: tuple[int, ...]) -> tuple[Floats, Mask, Mask]:
    """Truth, glass and metal, and all objects, at a size."""
    size = (shape[1], shape[0])
    clear = _at(frame.mask_of(*HARD), size)
    objects = _at(frame.mask, size) != BACKGROUND
    return _at(frame.depth_true, size), clear, objects


def probe_holes(
    restorer: Restorer, frames: Mapping[int, DepthFrame], protocol: Protocol
) -> dict[int, dict[str, float]]:
    """Cut holes into depth of frames that was right outside of glass and metal.

    Args:
        restorer: runs once more on every frame.
        frames: by index.
        protocol: whose view size holds.

    Returns:
        By index, figures by the names of `holes.NAMES`; NaN where no hole could be cut. A method
        that fails is off by the whole depth.
    """
    found = {index: dict.fromkeys(holes.NAMES, float("nan")) for index in frames}
    cuts = {}
    for index, frame in frames.items():
        sensor = _at(frame.depth_raw, seen_size(restorer, frame, protocol))
        true, clear, _ = _truth(frame, sensor.shape)
        cut = holes.cut_holes(sensor, frame.key, true=true, avoid=clear)
        if cut is not None:
            cuts[index] = cut
    views = {
        index: restorer_view(
            replace(frames[index], depth_raw=cut.cut), restorer, protocol.view_size
        )
        for index, cut in cuts.items()
    }
    for index, answer in restore_views(restorer, views).items():
        cut = cuts[index]
        seen = as_seen(restorer, cut.cut, answer, frames[index].color)
        found[index] |= with_nearest(cut, seen)
    return found


def holes_elsewhere(
    restore: Restore, frames: Iterable[Recorded], seed: int = 0
) -> dict[str, float]:
    """Cut holes into plain recordings, without any truth: what is put into them?

    The recordings must be of scenes without glass and metal, whose own depth would be judged.

    Args:
        restore: (H, W, 3) colour, (H, W) depth in metres and the camera to (H, W) restored depth,
            such as `lambda *view: Restorer.load("swindrnet").restore_view(*view).depth`.
        frames: name, colour, depth and camera of each frame.
        seed: of the holes.

    Returns:
        Means over frames by the names of `holes.NAMES`, NaN without any; `frames`: how many had
        depth to cut holes into.
    """
    rows = []
    for name, color, depth, camera in frames:
        cut = holes.cut_holes(depth, name, seed=seed)
        if cut is not None:
            rows.append(with_nearest(cut, restore(color, cut.cut, camera)))
    means = {
        name: _mean([row[name] for row in rows if not np.isnan(row[name])]) for name in holes.NAMES
    }
    return {**means, "frames": float(len(rows))}


def _mean(values: list[float]) -> float:
    return float(np.mean(values)) if values else float("nan")


def with_nearest(cut: holes.CutHoles, seen: NDArray[np.floating]) -> dict[str, float]:
    """The figures of an answer, and those of the nearest pixel beside."""
    nearest = cut.errors(fill_nearest(cut.cut, cut.cut == 0))
    beside = {f"{name}_nearest": nearest[name] for name in ("holes", "holes_d105")}
    return {**cut.errors(seen), **beside}


def probe_color(
    restorer: Restorer,
    frames: Mapping[int, DepthFrame],
    protocol: Protocol,
    answers: Mapping[int, Restored | str],
    other: Callable[[int], NDArray[np.uint8] | None],
) -> dict[int, dict[str, float]]:
    """The error on glass and metal with the true colour, with noise, with another frame's.

    Args:
        restorer: runs five times more on every frame with glass or metal.
        frames: by index.
        protocol: on whose main grid errors are compared.
        answers: with the true colour, by index.
        other: colour of another frame than that of an index; None if there is none.

    Returns:
        By index, RMSE in metres by the names of `COLORS`; NaN where there is no glass or metal.
    """
    scored = replace(
        protocol,
        grids=protocol.grids[:1],
        subsets=(Subset("glass and metal", HARD),),
        per_category=False,
        depth_bins=(),
    )

    def error(frame: DepthFrame, answer: Restored | str) -> float:
        depth = None if isinstance(answer, str) else answer.depth
        truth = (frame.depth_true, frame.mask, frame.instances)
        return score_depth(depth, *truth, scored, key=frame.key)[0].errors.rmse

    found = {index: dict.fromkeys((c.name for c in COLORS), float("nan")) for index in frames}
    clear = {i: frame for i, frame in frames.items() if frame.mask_of(*HARD).any()}
    strange = {index: other(index) for index in clear}
    for name in (column.name for column in COLORS):
        depth, color = name.split("_")
        if name == "color_true":
            done: Mapping[int, Restored | str] = {i: answers[i] for i in clear}
        else:
            views = {
                i: _view(restorer, frame, protocol, strange[i], color, bare=depth == "bare")
                for i, frame in clear.items()
                if color != "other" or strange[i] is not None
            }
            done = restore_views(restorer, views)
        for index, answer in done.items():
            found[index][name] = error(clear[index], answer)
    return found


def _view(
    restorer: Restorer,
    frame: DepthFrame,
    protocol: Protocol,
    strange: NDArray[np.uint8] | None,
    color: str,
    *,
    bare: bool,
) -> View:
    changes: dict[str, Any] = {}
    if bare:
        _, clear, _ = _truth(frame, frame.depth_raw.shape)
        changes["depth_raw"] = np.where(clear, np.float32(0), frame.depth_raw)
    if color == "other":
        changes["color"] = strange
    view = restorer_view(replace(frame, **changes), restorer, protocol.view_size)
    if color != "noise":
        return view
    # At the size of the view: noise that is made smaller becomes grey.
    seed = int.from_bytes(blake2b(frame.key.encode()).digest()[:8])
    noise = np.random.default_rng(seed).integers(0, 256, view.color.shape, dtype=np.uint8)
    return replace(view, color=noise)
