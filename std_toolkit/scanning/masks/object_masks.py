"""Masks of the object in the photos: the user's, or found on the table or before the border."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from std_toolkit.errors import ToolkitError
from std_toolkit.io.images import read_mask, write_color
from std_toolkit.jobs.artefact import Artefact
from std_toolkit.poses.board_scale import Board
from std_toolkit.scanning.board.object_checks import check_opaque
from std_toolkit.scanning.board.tags_through import check_tags
from std_toolkit.scanning.masks import candidates as standing
from std_toolkit.scanning.masks.masks import dilated, segment_by_border
from std_toolkit.scanning.masks.proven_masks import segment_on_table
from std_toolkit.scanning.options import LIMITS, ScanOptions
from std_toolkit.scanning.photos.posed_photos import PosedPhotos
from std_toolkit.scanning.photos.views import View
from std_toolkit.settings import Settings, limit

# Width of the rim of a mask that may lack a part of the object.
_RIM_PX = 3


@dataclass(frozen=True, kw_only=True)
class MaskFileSettings(Settings):
    """Masks of the user that are taken."""

    coarsest: float = limit(8.0, source="an outline has steps of as many pixels")
    """a mask may be so many times smaller than its photo"""


def object_masks(options: ScanOptions, posed: PosedPhotos, work: Path, threads: int) -> list[View]:
    """Views with the mask of the object; views that do not show it are left out.

    Args:
        options: `masks`, `pick`, `box` and `revolve` are used; the user's masks take precedence.
        posed: the photos.
        work: folder that keeps the masks.
        threads: to use.

    Raises:
        ToolkitError: several objects or none, masks that fit no photo, or a transparent object.
    """
    views = posed.views
    own = _own_masks(options.masks, posed)
    if len(own) == len(views):
        return [v.with_mask(own[v.name]) for v in views]
    values = {"pick": options.pick, "box": options.box, "format": 13}
    artefact = Artefact(work, "masks", {"poses": posed.digest}, values, limits=LIMITS)

    def make() -> dict[str, Any]:
        if not posed.on_table:
            done = segment_by_border(views, threads=threads)
        else:
            done = _on_table(options, posed, threads)
        out = {f"mask{i}": np.packbits(v.shown) for i, v in enumerate(done)}
        for i, v in enumerate(done):
            if v.hidden is not None:
                out[f"hidden{i}"] = np.packbits(v.hidden)
        return out

    a = artefact.arrays(make)
    done = []
    for i, view in enumerate(views):
        shape = view.image.shape[:2]
        count = shape[0] * shape[1]
        mask = np.unpackbits(a[f"mask{i}"], count=count).reshape(shape) > 0
        hidden = None
        if f"hidden{i}" in a:
            hidden = np.unpackbits(a[f"hidden{i}"], count=count).reshape(shape) > 0
        mask = own.get(view.name, mask)
        done.append(view.with_mask(mask, hidden))
    return [v for v in done if v.shown.any()]


def _on_table(options: ScanOptions, posed: PosedPhotos, threads: int) -> list[View]:
    views = posed.views
    pick, box = _pick(options, posed), _box(options, posed)
    if options.board is not None and not options.revolve:
        board = Board.read(options.board)
        if board.charuco is None:
            check_tags(views, posed.tags(), board.dictionary, threads=threads)
    found, compared = standing.find_candidates(views, posed.corners, threads=threads)
    clusters = standing.cluster_points(posed.points, views, pick=pick, box=box)
    if clusters is not None:
        found, chosen = clusters
    else:
        try:
            chosen = standing.choose_candidate(found, views, pick=pick, box=box)
        except ToolkitError:
            _draw_candidates(options.out / "candidates.jpg", views, found)
            raise
    if not options.revolve:
        check_opaque(views, posed.found, *found[chosen].inner)
    done = segment_on_table(views, found, chosen, compared, threads=threads)
    if len(found) > 1:
        return done
    # Beside the coarse hull, which is too large, no table was known: look at it once more.
    blocked = [dilated(v.shown, _RIM_PX) for v in done]
    compared = standing.compare_with_table(views, posed.corners, blocked, threads=threads)
    return segment_on_table(views, found, chosen, compared, threads=threads)


def _own_masks(folder: Path | None, posed: PosedPhotos) -> dict[str, NDArray[np.bool_]]:
    """Masks of the user by the name of the photo."""
    if folder is None:
        return {}
    if not folder.is_dir():
        raise ToolkitError("no such folder of masks", path=folder, field="--masks")
    found = {}
    for view in posed.views:
        path = folder / f"{Path(view.name).stem}.png"
        if path.is_file():
            mask = read_mask(path)
            h, w = view.image.shape[:2]
            # Photos and masks may be reduced, which rounds each side to a pixel.
            rounding = w + h + mask.shape[0] + mask.shape[1]
            if abs(mask.shape[1] * h - mask.shape[0] * w) > rounding:
                raise ToolkitError(
                    f"the mask has another shape than its photo, which is {w}x{h}", path=path,
                    value=f"{mask.shape[1]}x{mask.shape[0]}", hint="is it of another photo?",
                )  # fmt: skip
            coarsest = MaskFileSettings.current().coarsest
            if w > coarsest * mask.shape[1]:
                raise ToolkitError(
                    f"the mask is more than {coarsest:g} times smaller than its photo, which is "
                    f"{w}x{h}", path=path, value=f"{mask.shape[1]}x{mask.shape[0]}",
                    hint="give masks of the size of the photos",
                )  # fmt: skip
            if mask.shape != (h, w):
                mask = cv2.resize(mask, (w, h), interpolation=cv2.INTER_NEAREST)  # type: ignore[assignment]
            found[view.name] = mask > 0
    if not found:
        raise ToolkitError(
            "no mask is named as a photo", path=folder, field="--masks",
            hint=f"such as {Path(posed.views[0].name).stem}.png",
        )  # fmt: skip
    return found


def _numbers(text: str, option: str, count: int, posed: PosedPhotos) -> tuple[int, list[float]]:
    name, _, rest = text.rpartition(":")
    try:
        values = [float(x) for x in rest.split(",")]
    except ValueError:
        values = []
    if not name or len(values) != count or not np.isfinite(values).all():
        expected = "PHOTO:x,y" if count == 2 else "PHOTO:x0,y0,x1,y1"
        raise ToolkitError(
            f"expected {expected}", field=option, value=text, hint="numbers of pixels"
        )
    index = posed.photos.index_of(name, option)
    wanted = posed.photos.paths[index].name
    values = [v * posed.photos.factor_of(index) for v in values]
    for i, view in enumerate(posed.views):
        if view.name == wanted:
            return i, values
    raise ToolkitError("this photo has no camera pose", field=option, value=name)


def _pick(options: ScanOptions, posed: PosedPhotos) -> tuple[int, float, float] | None:
    if options.pick is None:
        return None
    i, (x, y) = _numbers(options.pick, "--pick", 2, posed)
    return i, x, y


def _box(options: ScanOptions, posed: PosedPhotos) -> tuple[int, float, float, float, float] | None:
    if options.box is None:
        return None
    i, (x0, y0, x1, y1) = _numbers(options.box, "--box", 4, posed)
    return i, x0, y0, x1, y1


def _draw_candidates(path: Path, views: Sequence[View], candidates: Sequence[Any]) -> None:
    view = max(views, key=lambda v: float(v.centre[2]))
    image = view.image.copy()
    for n, c in enumerate(candidates):
        uv, _ = view.project(c.vertices)
        uv = uv[np.isfinite(uv).all(axis=1)]
        if len(uv):
            x0, y0, x1, y1 = (int(v) for v in (*uv.min(axis=0), *uv.max(axis=0)))
            cv2.rectangle(image, (x0, y0), (x1, y1), (255, 60, 0), 2)
            cv2.putText(image, f"{n + 1}", (x0, y0 - 4), cv2.FONT_HERSHEY_SIMPLEX, 0.8,
                        (255, 60, 0), 2)  # fmt: skip
    cv2.putText(image, view.name, (8, 24), cv2.FONT_HERSHEY_SIMPLEX, 0.7, (255, 60, 0), 2)
    write_color(path, image)


def both_positions(options: ScanOptions) -> tuple[ScanOptions, ScanOptions]:
    """Options for the photos of each of two folders: `pick`, `box` and `masks` are divided.

    Raises:
        ToolkitError: a photo that both folders have is named without its folder.
    """
    assert options.flipped is not None
    folders, labels = (options.photos, options.flipped), options.labels()
    chosen: list[dict[str, Any]] = [{}, {}]
    for option in ("pick", "box"):
        text = getattr(options, option)
        if text is None:
            continue
        name, _, numbers = text.rpartition(":")
        folder, _, photo = name.rpartition("/")
        within = [
            n for n in range(2)
            if (folder in (labels[n], folders[n].name) if folder else _has(folders[n], photo))
        ]  # fmt: skip
        if len(within) != 1:
            raise ToolkitError(
                "both folders have this photo" if within else "no folder has this photo",
                field=f"--{option}", value=text, hint=f"such as {labels[1]}/{photo}:{numbers}",
            )  # fmt: skip
        chosen[within[0]][option] = f"{photo}:{numbers}"
    parts = []
    for n in range(2):
        masks = None if options.masks is None else options.masks / labels[n]
        if masks is not None and not masks.is_dir():
            masks = None
        parts.append(replace(options, photos=folders[n], flipped=None, masks=masks,
                             pick=chosen[n].get("pick"), box=chosen[n].get("box")))  # fmt: skip
    if options.masks is not None and parts[0].masks is None and parts[1].masks is None:
        raise ToolkitError(
            "no such folder of masks", path=options.masks / labels[0], field="--masks",
            hint=f"with two folders of photos, masks are in subfolders {labels[0]} and {labels[1]}",
        )  # fmt: skip
    return parts[0], parts[1]


def _has(folder: Path, photo: str) -> bool:
    """Whether a folder has a photo of a file name or stem; a video has frames of any name."""
    if not folder.is_dir():
        return True
    return any(photo in (p.name, p.stem) for p in folder.iterdir())
