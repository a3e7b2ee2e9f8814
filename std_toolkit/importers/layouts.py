"""Layouts of data sets and apps that consist of a folder of colour and one of depth images.

tum        rgb/ and depth/ with rgb.txt and depth.txt; 5000 units per metre
icl-nuim   as tum, with *.gt.freiburg; intrinsics and the left-handed axes are those published
redwood    color/, rgb/ or image/ and depth/ with Open3D's intrinsics
replica    results/frame*.jpg and results/depth*.png with cam_params.json
scannet    color/, depth/, pose/, intrinsic/intrinsic_color.txt
7scenes    frame-*.color.png, frame-*.depth.png, frame-*.pose.txt in one folder
record3d   rgb/ and depth/ with metadata.json
separate   color/ and depth/ with intrinsics.json or another file of intrinsics
"""

from dataclasses import dataclass
from pathlib import Path

_COLOR = ("color", "rgb", "image", "images", "colour")
_DEPTH = ("depth", "depths")
_INTRINSICS = (
    "intrinsics.json", "intrinsics.yaml", "intrinsics.yml", "intrinsics.txt", "camera.json",
    "intrinsic.json", "camera_intrinsic.json", "camera_intrinsics.json", "camera_primesense.json",
    "camera_intrinsics.yaml", "camera-intrinsics.txt", "intrinsic.txt", "camera_info.yaml",
    "camera.yaml", "calibration.yaml", "calib.yaml", "cam_params.json", "transforms.json",
    "info.txt", "_info.txt",
)  # fmt: skip
_POSES = ("groundtruth.txt", "traj.txt", "trajectory.log", "poses.txt", "transforms.json")
_IMAGES = (".png", ".jpg", ".jpeg")
# Of ICL-NUIM (Handa, Whelan, McDonald and Davison, ICRA 2014), whose page writes fy as -480.
_ICL_NUIM = "481.2,480,319.5,239.5"
# Of the formats as their authors file them, metres per unit.
_TUM_UNIT, _MILLIMETRES = 0.0002, 0.001


@dataclass(frozen=True, kw_only=True)
class Layout:
    """Where the images of a folder are.

    Attributes:
        kind: name in the module's table.
        color, depth: folders or patterns.
        intrinsics: file of intrinsics, or four numbers that the format fixes.
        depth_scale: metres per unit that the layout fixes.
        poses: file or folder of camera poses, which are not read without --cameras.
        convention: of these poses, if another than that of their format.
    """

    kind: str
    color: str
    depth: str
    intrinsics: Path | str | None = None
    depth_scale: float | None = None
    poses: Path | None = None
    convention: str | None = None


def find_layout(source: Path) -> Layout | None:
    """The layout of a folder, from the names of its files; None if it has none of them."""
    if not source.is_dir() or (source / "scene_camera.json").is_file():
        return None
    names = [p.name for p in source.iterdir() if p.is_file()]
    if any(n.endswith(".color.png") or n.endswith(".color.jpg") for n in names) and any(
        n.endswith(".depth.png") for n in names
    ):
        kind = "7scenes" if any(n.endswith(".pose.txt") for n in names) else "separate"
        poses = source if kind == "7scenes" else None
        return Layout(
            kind=kind,
            color=str(source),
            depth=str(source),
            intrinsics=_intrinsics(source),
            depth_scale=_MILLIMETRES if kind == "7scenes" else None,
            poses=poses,
        )
    results = source / "results"
    if results.is_dir() and any(results.glob("frame*.jpg")) and any(results.glob("depth*.png")):
        return Layout(
            kind="replica",
            color=str(results / "frame*"),
            depth=str(results / "depth*"),
            intrinsics=_intrinsics(source) or _intrinsics(source.parent),
            poses=_poses(source),
        )
    color = next((source / n for n in _COLOR if _has_images(source / n)), None)
    depth = next((source / n for n in _DEPTH if (source / n).is_dir()), None)
    if color is None or depth is None:
        return None
    calibration = source / "intrinsic" / "intrinsic_color.txt"
    if calibration.is_file():
        pose = source / "pose"
        return Layout(
            kind="scannet",
            color=str(color),
            depth=str(depth),
            intrinsics=calibration,
            depth_scale=_MILLIMETRES,
            poses=pose if pose.is_dir() else None,
        )
    if (source / "rgb.txt").is_file() and (source / "depth.txt").is_file():
        return Layout(
            kind="tum",
            color=str(color),
            depth=str(depth),
            intrinsics=_intrinsics(source),
            depth_scale=_TUM_UNIT,
            poses=_poses(source),
        )
    if trajectory := next(iter(sorted(source.glob("*.gt.freiburg"))), None):
        return Layout(
            kind="icl-nuim",
            color=str(color),
            depth=str(depth),
            intrinsics=_intrinsics(source) or _ICL_NUIM,
            depth_scale=_TUM_UNIT,
            poses=trajectory,
            convention="camera-to-world-unity",
        )
    if color.name == "rgb" and (source / "metadata.json").is_file():
        return Layout(
            kind="record3d", color=str(color), depth=str(depth), intrinsics=source / "metadata.json"
        )
    intrinsics = _intrinsics(source)
    open3d = intrinsics is not None and intrinsics.name.startswith(("intrinsic.", "camera_"))
    return Layout(
        kind="redwood" if open3d else "separate",
        color=str(color),
        depth=str(depth),
        intrinsics=intrinsics,
        poses=_poses(source),
    )


def _has_images(folder: Path) -> bool:
    return folder.is_dir() and any(p.suffix.lower() in _IMAGES for p in folder.iterdir())


def _intrinsics(folder: Path) -> Path | None:
    return next((folder / n for n in _INTRINSICS if (folder / n).is_file()), None)


def _poses(folder: Path) -> Path | None:
    found = next((folder / n for n in _POSES if (folder / n).is_file()), None)
    pose = folder / "pose"
    return pose if found is None and pose.is_dir() else found
