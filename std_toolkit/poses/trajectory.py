"""Export of camera trajectories to the formats of other tools."""

import csv
import io
import json
from collections.abc import Callable
from pathlib import Path

import numpy as np

from std_toolkit.errors import ToolkitError
from std_toolkit.geometry import SE3
from std_toolkit.io.atomic import new_folder, write_bytes_atomic
from std_toolkit.io.colmap_files import check_colmap_model
from std_toolkit.log import logger
from std_toolkit.scene import Scene

# OpenCV camera axes (x right, y down, z forward) to OpenGL's (x right, y up, z backward).
_GL_FROM_CV = np.diag([1.0, -1.0, -1.0, 1.0])


def write_trajectory(scene: Scene, out: Path, *, format: str = "csv") -> None:
    """Write the camera poses of a scene.

    Args:
        scene: scene with poses; an unknown unit gives a warning.
        out: file for csv, tum and nerf; new or empty folder for colmap.
        format: one of `FORMATS`.

    Raises:
        ToolkitError: unknown format, no poses, a folder that is not empty, or a lens model that
            the format cannot represent.
    """
    if format not in FORMATS:
        raise ToolkitError(
            "unknown trajectory format", value=format, hint=f"one of {', '.join(FORMATS)}"
        )
    poses = scene.poses
    if poses is None:
        raise ToolkitError(
            "this scene has no camera poses", path=scene.root, hint="run `std-curate poses` first"
        )
    if poses.scale is not None and poses.scale.unit != "metre":
        logger.warning(
            "%s: the unit of these poses is unknown: the numbers in %s are NOT metres; run "
            "`std-curate poses` with a scale source",
            scene.root,
            out,
        )
    FORMATS[format](scene, Path(out))


def _write_csv(scene: Scene, out: Path) -> None:
    """Write a row per frame; `m00`..`m33` is T_world_cam, row-major, metres, or empty."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    columns = [f"m{r}{c}" for r in range(4) for c in range(4)]
    writer.writerow(["frame", "name", "status", "reprojection_px", *columns])
    by_frame = {p.frame: p for p in scene.poses.frames} if scene.poses else {}
    for frame in scene.frames:
        pose = by_frame.get(frame.id)
        if pose is None or pose.T_world_cam is None:
            writer.writerow([frame.id, frame.name, "unregistered", ""] + [""] * 16)
            continue
        error = "" if pose.reprojection_px is None else f"{pose.reprojection_px:.4f}"
        # repr() is exact: reading it back gives the saved number.
        numbers = [repr(float(x)) for x in pose.T_world_cam]
        writer.writerow([frame.id, frame.name, pose.status, error, *numbers])
    write_bytes_atomic(out, text.getvalue().encode())


def _write_tum(scene: Scene, out: Path) -> None:
    """Write `timestamp tx ty tz qx qy qz qw` of T_world_cam; frame ids if times are missing."""
    lines = ["# timestamp tx ty tz qx qy qz qw"]
    timed = all(f.timestamp is not None for f in scene.frames)
    for frame in scene.frames:
        T = scene.T_world_cam(frame.id)
        if T is None:
            continue
        w, x, y, z = T.quat()
        stamp = f"{frame.timestamp:.6f}" if timed else str(frame.id)
        lines.append(" ".join([stamp, *(f"{v:.12f}" for v in (*T.t, x, y, z, w))]))
    write_bytes_atomic(out, ("\n".join(lines) + "\n").encode())


def _write_colmap(scene: Scene, out: Path) -> None:
    """Write the model of the pose step as COLMAP text, or else cameras and images only."""
    import pycolmap

    from std_toolkit.poses.colmap import quiet_colmap, to_colmap_camera, to_rigid3d

    with new_folder(out) as work, quiet_colmap():
        if (
            scene.poses
            and scene.poses.source == "sfm"
            and (scene.root / "poses" / "sparse").is_dir()
        ):
            check_colmap_model(scene.root / "poses" / "sparse")
            model = pycolmap.Reconstruction(scene.root / "poses" / "sparse")
        else:
            model = pycolmap.Reconstruction()
            numbers = {key: i for i, key in enumerate(sorted(scene.info.cameras), start=1)}
            for key, number in numbers.items():
                frame = next((f for f in scene.frames if f.camera == key), None)
                if frame is not None:
                    camera = to_colmap_camera(scene.camera(frame), number)
                    model.add_camera_with_trivial_rig(camera)
            for frame in scene.frames:
                T: SE3 | None = scene.T_world_cam(frame.id)
                if T is not None:
                    image = pycolmap.Image(
                        name=frame.color,
                        camera_id=numbers[frame.camera],
                        image_id=frame.id + 1,
                    )
                    model.add_image_with_trivial_frame(image, to_rigid3d(T.inverse()))
        model.write_text(work)


def _write_nerf(scene: Scene, out: Path) -> None:
    """Write `transforms.json`: camera-to-world in OpenGL axes.

    As in other tools that use this format, `cx` and `cy` start at the outer corner of the first
    pixel: they are half a pixel larger than the toolkit's.
    """
    frames = []
    for frame in scene.frames:
        T = scene.T_world_cam(frame.id)
        if T is None:
            continue
        camera = scene.camera(frame)
        k = camera.opencv_distortion
        if any(k[5:]):
            raise ToolkitError(
                "transforms.json cannot store the coefficients k4, k5 and k6",
                path=scene.root / "scene.json",
                field=f"cameras.{frame.camera}.distortion",
                value=list(camera.distortion),
                hint="use --format colmap",
            )
        frames.append(
            {
                "file_path": frame.color,
                "transform_matrix": (T.matrix() @ _GL_FROM_CV).tolist(),
                "w": camera.width,
                "h": camera.height,
                "fl_x": camera.fx,
                "fl_y": camera.fy,
                "cx": camera.cx + 0.5,
                "cy": camera.cy + 0.5,
                "k1": k[0],
                "k2": k[1],
                "p1": k[2],
                "p2": k[3],
                "k3": k[4],
            }
        )
    document = {"camera_model": "OPENCV", "frames": frames}
    write_bytes_atomic(out, (json.dumps(document, indent=1) + "\n").encode())


FORMATS: dict[str, Callable[[Scene, Path], None]] = {
    "csv": _write_csv,
    "tum": _write_tum,
    "colmap": _write_colmap,
    "nerf": _write_nerf,
}
