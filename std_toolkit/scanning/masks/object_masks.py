"""Masks of the object in the photos: the user's, or found on the table or before the border."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from std_toolkit.arrays import Array
from std_toolkit.errors import ToolkitError
from std_toolkit.geometry.ray_caster import RayCaster
from std_toolkit.io.images import read_mask
from std_toolkit.jobs.artefact import Artefact
from std_toolkit.log import logger
from std_toolkit.poses.board_scale import Board
from std_toolkit.scanning.board.object_checks import check_opaque
from std_toolkit.scanning.board.tags_through import check_tags, tags_at_place, tags_through
from std_toolkit.scanning.masks.candidates import (
    Candidate,
    compare_with_table,
    compare_with_tables,
    find_candidates,
)
from std_toolkit.scanning.masks.masks import dilated, segment_by_border
from std_toolkit.scanning.masks.outlines import Shown, best_photos, draw_candidates
from std_toolkit.scanning.masks.proven_masks import segment_on_table
from std_toolkit.scanning.masks.standing import (
    Standing,
    choose_candidate,
    find_standing,
    sure_candidates,
)
from std_toolkit.scanning.masks.table_comparison import Comparison
from std_toolkit.scanning.masks.table_model import TableModel, model_tables
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


class Things:
    """What stands on the board of a recording: found when it is asked for, once for all objects.

    Args:
        posed: the photos.
        threads: to use.
    """

    def __init__(self, posed: PosedPhotos, threads: int) -> None:
        self.posed, self._threads = posed, threads
        self._through: list[tuple[View, list[int]]] | None = None

    @cached_property
    def bare(self) -> dict[str, Array]:
        """Corners of the bare tags of each photo."""
        return tags_at_place(self.posed.views, self.posed.found, self.posed.tags())

    @cached_property
    def standing(self) -> Standing:
        """The objects."""
        posed = self.posed
        found = find_standing(
            posed.views, posed.corners, posed.points, self.bare, threads=self._threads
        )
        logger.info("%d objects stand on the board", len(found.candidates))
        return found

    @cached_property
    def _tables(self) -> list[TableModel]:
        """The table without what stands on it."""
        views = self.posed.views
        blocked = self.standing.hull.silhouettes(views)
        return model_tables(views, self.posed.corners, blocked, threads=self._threads)

    def compared(self, one: Candidate) -> list[Comparison]:
        """The photos against the table around an object."""
        vertices, _ = one.outer
        box = np.stack([vertices.min(axis=0), vertices.max(axis=0)])
        return compare_with_tables(
            self.posed.views, self._tables, bare=self.bare, within=box, threads=self._threads
        )

    @cached_property
    def shown(self) -> list[Shown]:
        """Each object in its best photo."""
        return best_photos(self.standing.candidates, self.posed.views)

    def picks(self, folder: str = "") -> list[str]:
        """What `--pick` is given for each object: a photo and a whole pixel of it.

        Args:
            folder: of the photos, if there are two.
        """
        photos = self.posed.photos
        paths = {path.name: i for i, path in enumerate(photos.paths)}
        words = []
        for one in self.shown:
            name = self.posed.views[one.photo].name
            x, y = (round(v / photos.factor_of(paths[name])) for v in one.pixel)
            words.append(f"{folder}/{name}:{x},{y}" if folder else f"{name}:{x},{y}")
        return words

    @property
    def many(self) -> bool:
        """Whether there are several objects."""
        return len(self.standing.candidates) > 1

    def check_tags(self, options: ScanOptions, candidate: Candidate | None = None) -> None:
        """Raise an error if tags of the board are seen through the object, or through a candidate.

        Raises:
            ToolkitError: the object is transparent.
        """
        if options.board is None or options.revolve:
            return
        tags = self.posed.tags()
        if self._through is None:
            board = Board.read(options.board)
            self._through = [] if board.charuco is not None else tags_through(
                self.posed.views, tags, board.dictionary, threads=self._threads
            )  # fmt: skip
        caster = None if candidate is None else RayCaster(*candidate.outer, threads=1)
        check_tags(self._through, tags, caster)

    def draw(self, path: Path, names: Sequence[str] = (), folder: str = "") -> None:
        """Write the picture of all objects: each outlined, with its number or name and its pick.

        Places that are left out come after them, and a warning counts them.
        """
        picks = self.picks(folder)
        names = names or [str(n) for n in range(1, len(picks) + 1)]
        words = [f"{name}  --pick {pick}" for name, pick in zip(names, picks, strict=True)]
        beside = [s for s in best_photos(self.standing.left_out, self.posed.views) if s.mask.any()]
        words += [f"not scanned, in {self.posed.views[one.photo].name}" for one in beside]
        draw_candidates(path, [*self.shown, *beside], self.posed.views, words)
        if beside:
            logger.warning(
                "places on the board that stand out and are not scanned: %d. Photos show the table "
                "there in part: flat, thin, clear or black things, or shadows. %s shows them; scan "
                "such a thing alone, with --masks", len(beside), path,
            )  # fmt: skip


def object_masks(
    options: ScanOptions,
    posed: PosedPhotos,
    work: Path,
    threads: int,
    things: Things | None = None,
    *,
    folder: str = "",
) -> list[View]:
    """Views with the mask of the object; views that do not show it are left out.

    Args:
        options: `masks`, `pick`, `box` and `revolve` are used; the user's masks take precedence.
        posed: the photos.
        work: folder that keeps the masks.
        threads: to use.
        things: what stands on the board, if that is known.
        folder: of the photos, if there are two.

    Raises:
        ToolkitError: several objects or none, masks that fit no photo, or a transparent object.
    """
    views = posed.views
    own = own_masks(options.masks, posed)
    if len(own) == len(views):
        return [v.with_mask(own[v.name]) for v in views]
    values = {"pick": options.pick, "box": options.box, "format": 15}
    artefact = Artefact(work, "masks", {"poses": posed.digest}, values, limits=LIMITS)

    def make() -> dict[str, Any]:
        if not posed.on_table:
            done = segment_by_border(views, threads=threads)
        else:
            done = table_masks(options, things or Things(posed, threads), threads, folder)
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


def table_masks(options: ScanOptions, things: Things, threads: int, folder: str = "") -> list[View]:
    """All views with the mask of the object on the table; arguments as of `object_masks`.

    Raises:
        ToolkitError: several objects or none, or a transparent one.
    """
    posed = things.posed
    views = posed.views
    pick, box = _pick(options, posed), _box(options, posed)
    if not things.many:
        # One object, unless a closer look finds more.
        things.check_tags(options)
        found, compared = find_candidates(views, posed.corners, things.bare, threads=threads)
        found = sure_candidates(found, views, posed.corners, compared, things.standing.tags)
        things.standing = replace(things.standing, candidates=found)
    if things.many and pick is None and box is None:
        raise _several(options, things, folder)
    found, chosen = choose_candidate(things.standing.candidates, views, pick=pick, box=box)
    if things.many:
        things.check_tags(options, found[chosen])
        compared = things.compared(found[chosen])
    if not options.revolve:
        check_opaque(views, posed.found, *found[chosen].inner)
    done = segment_on_table(views, found, chosen, compared, threads=threads)
    if len(found) > 1:
        return done
    # Beside the coarse hull, which is too large, no table was known: look at it once more.
    blocked = [dilated(v.shown, _RIM_PX) for v in done]
    compared = compare_with_table(views, posed.corners, blocked, bare=things.bare, threads=threads)
    return segment_on_table(views, found, chosen, compared, threads=threads)


def _several(options: ScanOptions, things: Things, folder: str) -> ToolkitError:
    """The error that says how to choose one of several objects; they are drawn."""
    path = options.out / "candidates.jpg"
    things.draw(path, folder=folder)
    picks = "; ".join(f"{n}: --pick {pick}" for n, pick in enumerate(things.picks(folder), start=1))
    problem = f"{len(things.standing.candidates)} objects stand on the board: {picks}"
    try:
        things.check_tags(options)
    except ToolkitError as error:
        # Parts of one clear object look like several.
        problem, advice = f"{error.problem}; {problem}", f"; if it is one object: {error.hint}"
    else:
        advice = ""
    hint = f"choose one of them, which {path} shows, or scan all with --all{advice}"
    return ToolkitError(problem, hint=hint)


def own_masks(folder: Path | None, posed: PosedPhotos) -> dict[str, NDArray[np.bool_]]:
    """Masks of the user by the name of the photo.

    Raises:
        ToolkitError: masks that fit no photo.
    """
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
