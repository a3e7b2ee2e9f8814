"""The maps of one frame in the camera of a layout.

The layouts support pinhole cameras only, and STD's labels have half the size of the colour image.
If the camera equals that of the scene, the rendered ground truth is used unchanged. Otherwise it
is rendered again: resampling the maps would shift depth and NOCS by up to half a pixel (0.4 mm at
0.7 m), while a new rendering is exact. Occlusion by unlabelled surfaces (policies "sensor" and
"fused") is then copied from the ground truth, to its pixel.
"""

from collections.abc import Collection
from dataclasses import dataclass, replace

import cv2
import msgspec
import numpy as np
from numpy.typing import NDArray

from std_toolkit.errors import ToolkitError
from std_toolkit.geometry.camera import Camera, undistort_image
from std_toolkit.jobs.artefact import changed_files
from std_toolkit.rendering import choose, ground_truth, maps, placements
from std_toolkit.rendering.renderer import image_window
from std_toolkit.scene import Frame, Scene


@dataclass(frozen=True, eq=False)
class FrameMaps:
    """Ground truth of one frame in one pinhole camera.

    Attributes:
        truth: numbers of this camera's maps.
        depth: (H, W) float32 metres, 0 = background.
        mask: (H, W) uint8 object ids, 0 = background.
        nocs: (H, W, 3) float32 in 0..1, not flipped, 0 in the background.
    """

    truth: ground_truth.FrameTruth
    depth: NDArray[np.float32]
    mask: NDArray[np.uint8]
    nocs: NDArray[np.float32]


def color_camera(scene: Scene, frame: Frame) -> Camera:
    """The pinhole camera of a frame's exported colour image."""
    return scene.camera(frame).without_distortion()


def read_color(scene: Scene, frame: Frame) -> NDArray[np.uint8]:
    """Colour (H, W, 3) in the pinhole camera."""
    return undistort_image(scene.read_color(frame), scene.camera(frame))  # type: ignore[return-value]


def read_sensor_depth(scene: Scene, frame: Frame) -> NDArray[np.float32] | None:
    """Sensor depth (H, W) in metres in the pinhole camera, with the correction factor applied."""
    depth = scene.read_depth(frame)
    if depth is None:
        return None
    return undistort_image(  # type: ignore[return-value]
        depth, scene.camera(frame), interpolation=cv2.INTER_NEAREST
    )


def check_fresh(scene: Scene, truth: ground_truth.FrameTruth) -> None:
    """Check that ground truth belongs to the current state of the scene, and was not changed.

    Raises:
        ToolkitError: a label, camera, mesh, the scale of the depth or a map changed after
            rendering, or the depth cannot be read at all.
    """
    frame = scene.frame(truth.frame)
    if scene.info.depth_scale is None and frame.depth is not None and frame.depth.endswith(".png"):
        scene.read_depth(frame)  # a damaged scene, not an outdated one: names the file
    if not placements.truth_is_current(scene, truth):
        raise ToolkitError(
            "the ground truth is older than the labels, the camera or the meshes",
            path=scene.root,
            field=f"frame {truth.frame}",
            hint="run `std-curate render` again",
        )
    if changed := changed_files(scene.root, truth.outputs):
        raise ToolkitError(
            "the ground truth is not what was rendered", path=scene.root,
            field=f"frame {truth.frame}", value=changed[0], hint="run `std-curate render` again",
        )  # fmt: skip


def frame_maps(
    scene: Scene, frame: Frame, camera: Camera, without: Collection[int] = ()
) -> FrameMaps:
    """Ground truth of a frame in `camera`, a pinhole over the same field of view.

    Args:
        scene, frame: what is exported.
        camera: of the labels.
        without: ids of the objects whose pixels become background (`Target.left_out`); their rows
            are absent.

    Raises:
        ToolkitError: the frame was not rendered, or its ground truth is stale or damaged.
    """
    found = ground_truth.read_ground_truth(scene, frame.id)
    check_fresh(scene, found.info)
    if camera == scene.camera(frame):
        maps = FrameMaps(found.info, found.depth, found.mask, found.nocs)
    else:
        maps = _rendered(scene, frame, camera, found)
    return _cleared(maps, without) if without else maps


def _cleared(found: FrameMaps, without: Collection[int]) -> FrameMaps:
    """The maps with background in place of some objects."""
    gone = np.isin(found.mask, list(without))
    rows = [row for row in found.truth.objects if row.object not in without]
    return replace(
        found,
        truth=msgspec.structs.replace(found.truth, objects=rows),
        depth=np.where(gone, np.float32(0), found.depth),
        mask=np.where(gone, np.uint8(0), found.mask),
        nocs=np.where(gone[..., None], np.float32(0), found.nocs),
    )


def _rendered(
    scene: Scene, frame: Frame, camera: Camera, found: ground_truth.GroundTruth
) -> FrameMaps:
    placed = placements.place_meshes(scene, placements.frame_placements(scene, frame.id))
    renderer = choose.get_renderer(choose.choose_renderer(found.info.renderer, cameras=[camera]))
    composition = maps.compose(renderer, camera, placed, canvas=3)
    ids = [p.object_id for p in placed]
    if found.info.policy != "models":
        hidden = _hidden(composition, ids, scene.camera(frame), camera, found.mask)
        composition.depth[hidden] = 0
        composition.index[hidden] = -1
        composition.face[hidden] = -1
    nocs, _ = maps.surface_maps(camera, placed, composition, smooth_normals=False)
    sensor = read_sensor_depth(scene, frame)
    if sensor is not None and camera.size != color_camera(scene, frame).size:
        sensor = cv2.resize(sensor, camera.size, interpolation=cv2.INTER_NEAREST_EXACT)  # type: ignore[assignment]
    old = {row.object: row for row in found.info.objects}
    rows = [_row(old[i], composition, k, camera, sensor) for k, i in enumerate(ids)]
    truth = msgspec.structs.replace(found.info, objects=rows, outputs={})
    mask = maps.mask_of(composition.index, ids)
    return FrameMaps(truth, composition.depth, mask, nocs)


def _hidden(
    composition: maps.Composition,
    ids: list[int],
    source: Camera,
    camera: Camera,
    mask: NDArray[np.uint8],
) -> NDArray[np.bool_]:
    """Pixels whose object is absent from the surrounding 2x2 pixels of the ground truth."""
    shown = np.array([*ids, 0], np.uint8)[composition.index]
    uv = source.project(camera.rays())
    column, row = np.floor(uv[..., 0]).astype(np.intp), np.floor(uv[..., 1]).astype(np.intp)
    seen = np.zeros(shown.shape, bool)
    for dy in (0, 1):
        for dx in (0, 1):
            y = np.clip(row + dy, 0, source.height - 1)
            x = np.clip(column + dx, 0, source.width - 1)
            seen |= mask[y, x] == shown
    return (shown > 0) & ~seen


def _row(
    old: ground_truth.ObjectTruth,
    composition: maps.Composition,
    index: int,
    camera: Camera,
    sensor: NDArray[np.float32] | None,
) -> ground_truth.ObjectTruth:
    silhouette = composition.silhouettes[index]
    visible = composition.index == index
    amodal = silhouette.image_mask(camera)
    valid = amodal if sensor is None else amodal & (sensor > 0)
    px_visible = int(np.count_nonzero(visible))
    box = silhouette.box
    visible_box = maps.mask_box(visible, image_window(camera))
    return ground_truth.ObjectTruth(
        object=old.object,
        T_cam_obj=old.T_cam_obj,
        px_all=silhouette.px_all,
        px_valid=int(np.count_nonzero(valid)),
        px_visible=px_visible,
        visible_fraction=px_visible / silhouette.px_all if silhouette.px_all else 0.0,
        bbox_amodal=None if box is None else list(box),
        bbox_visible=None if visible_box is None else list(visible_box),
    )
