"""Small sets of images: all pairs are matched, and the best of several models is kept.

A ring of views around an object has wide baselines, so features at twice the resolution are
needed, and often those of low contrast. COLMAP's default thresholds are kept: with weaker ones,
or with guided matching, more images are registered on objects of little texture, but at wrong
poses.
"""

import shutil
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np
import pycolmap

from std_toolkit.geometry import Camera
from std_toolkit.options import PoseOptions
from std_toolkit.poses.colmap import from_colmap_camera, from_rigid3d
from std_toolkit.poses.mapping import (
    Mapping,
    MappingImage,
    adjust,
    map_database,
    match_keyframes,
)
from std_toolkit.poses.pose_check import Tracks
from std_toolkit.settings import NOT_RECORDED, Settings, limit

# Images this near in the order of the set see the same side of an object.
_NEIGHBOURS = 2


@dataclass(frozen=True, kw_only=True)
class SmallSetSettings(Settings):
    """Which models of few images are right."""

    fewest_points: int = limit(10, source=NOT_RECORDED)
    """an image with fewer points after bundle adjustment has no reliable pose"""
    explained: float = limit(
        0.95,
        source="rings of six textured meshes: right models explain 0.98 and more, wrong ones "
        "0.82 to 0.89",
    )
    """smallest fraction of matches that a model explains"""
    explained_px: float = limit(4.0, unit="px", source=NOT_RECORDED)
    """largest reprojection error of a match that is explained"""


@dataclass(frozen=True)
class SmallSetMapping:
    """Result of `map_small_set`.

    Attributes:
        mapping: the model.
        explained: fraction of the verified matches of neighbouring images that it explains.
    """

    mapping: Mapping
    explained: float


def rank_model(model: Any) -> tuple[int, float]:
    """Sort key of models: more registered images, then a lower reprojection error."""
    return model.num_reg_images(), -model.compute_mean_reprojection_error()


def map_small_set(
    images: Callable[[bool], Sequence[MappingImage]],
    cameras: dict[str, Camera],
    work: Path,
    *,
    options: PoseOptions,
) -> SmallSetMapping | None:
    """Match all pairs of the images and map them.

    If images are left out, or the model contradicts matches of neighbouring images, only pairs of
    neighbours are mapped: equal sides of an object match each other, but they are no neighbours
    on a ring. If images are still left out, features of low contrast are added.

    Args:
        images: returns all images; the argument adds features of low contrast.
        cameras: intrinsics by camera key.
        work: folder for the databases; the caller removes it.
        options: options of the pose step.

    Returns:
        The best model, adjusted; None if no two images fit together.
    """
    found: list[SmallSetMapping] = []
    for faint in (False, True):
        chosen = images(faint)
        folder = work / f"all-pairs-{int(faint)}"
        folder.mkdir()
        pairs = list(combinations(range(len(chosen)), 2))
        database, camera_ids = match_keyframes(chosen, pairs, cameras, folder, options=options)
        order = {x.image_id: i for i, x in enumerate(chosen)}
        for near in (False, True):
            used = _neighbours_only(database, folder, order) if near else database
            place = folder / f"map-{int(near)}"
            place.mkdir()
            ranked = map_database(used, place, options=options)
            if ranked:
                found.append(_adjusted(ranked, chosen, database, order, camera_ids, options))
            if found and _complete(found[-1], len(chosen)):
                break
        if any(x.mapping.model.num_reg_images() == len(chosen) for x in found):
            break
    return max(found, key=_rank, default=None)


def _rank(result: SmallSetMapping) -> tuple[int, bool, float]:
    registered, quality = rank_model(result.mapping.model)
    return registered, result.explained >= SmallSetSettings.current().explained, quality


def _complete(result: SmallSetMapping, count: int) -> bool:
    model = result.mapping.model
    return (
        bool(model.num_reg_images() == count)
        and result.explained >= SmallSetSettings.current().explained
    )


def _adjusted(
    ranked: Sequence[Any],
    images: Sequence[MappingImage],
    database: Path,
    order: dict[int, int],
    camera_ids: dict[str, int],
    options: PoseOptions,
) -> SmallSetMapping:
    model = ranked[-1]
    adjust(model, refine=options.refine, threads=options.threads)
    for number in list(model.reg_image_ids()):
        image = model.image(number)
        if image.num_points3D < SmallSetSettings.current().fewest_points:
            model.deregister_frame(image.frame_id)
    others = [m.num_reg_images() for m in ranked[-2::-1]]
    explained = explained_matches(model, images, verified_matches(database), order)
    return SmallSetMapping(Mapping(model, camera_ids, others), explained)


def verified_matches(database: Path) -> list[tuple[int, int, Any]]:
    """Return the verified matches of a database: (image id, image id, (M, 2) feature indices)."""
    with pycolmap.Database.open(database) as opened:
        numbers, geometries = opened.read_two_view_geometries()
    found = []
    for number, geometry in zip(numbers, geometries, strict=True):
        a, b = pycolmap.pair_id_to_image_pair(number)
        if len(geometry.inlier_matches):
            found.append((a, b, np.asarray(geometry.inlier_matches, dtype=np.int64)))
    return found


def explained_matches(
    model: Any,
    images: Sequence[MappingImage],
    matches: Sequence[tuple[int, int, Any]],
    order: dict[int, int],
) -> float:
    """Return the fraction of the matches of neighbouring registered images that a model explains.

    Args:
        model: pycolmap.Reconstruction.
        images: all images.
        matches: result of `verified_matches`.
        order: position of each image id in the set; the first follows the last.
    """
    uv = {x.image_id: x.features().uv for x in images}
    poses = {
        i: from_rigid3d(model.image(i).cam_from_world()).inverse() for i in model.reg_image_ids()
    }
    lens = {i: from_colmap_camera(model.camera(model.image(i).camera_id)) for i in poses}
    total, good = 0, 0
    for a, b, pairs in matches:
        if a not in poses or b not in poses or not _near(order[a], order[b], len(order)):
            continue
        pixels = np.stack([uv[a][pairs[:, 0]], uv[b][pairs[:, 1]]], axis=1).reshape(-1, 2)
        tracks = Tracks(np.tile([a, b], len(pairs)), pixels, np.arange(0, 2 * len(pairs) + 1, 2))
        errors = tracks.errors(poses, lens).reshape(-1, 2).max(axis=1)
        total += len(pairs)
        good += int((errors < SmallSetSettings.current().explained_px).sum())
    return good / total if total else 1.0


def _near(a: int, b: int, count: int) -> bool:
    steps = abs(a - b)
    return min(steps, count - steps) <= _NEIGHBOURS


def _neighbours_only(database: Path, folder: Path, order: dict[int, int]) -> Path:
    """Copy the database without the matches of images that are no neighbours."""
    copy = folder / "neighbours.db"
    shutil.copyfile(database, copy)
    with pycolmap.Database.open(copy) as opened:
        for a, b, _ in verified_matches(database):
            if not _near(order[a], order[b], len(order)):
                opened.delete_two_view_geometry(a, b)
                opened.delete_matches(a, b)
    return copy
