"""Camera poses: `std-curate poses` against plain pycolmap, in one run on the same images.

    python perf/poses.py [--images DIR --intrinsics FILE] [--skip-exhaustive]

Prints a table of wall times, processor times and their ratios. "plain" is pycolmap with its default
options on all frames, fixed pinhole intrinsics, incremental mapping; features are part of every
time.
"""

from __future__ import annotations

import argparse
import json
import os
import resource
import shutil
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np

REPOSITORY = Path(__file__).resolve().parent.parent
DATA = Path(os.environ.get("STD_TEST_DATA", REPOSITORY.parent / "shared" / "data"))


def make_scene(images: Path, K: np.ndarray, root: Path) -> Any:
    from std_toolkit.io.images import image_size
    from std_toolkit.scene import CameraModel, Frame, Frames, Scene, SceneInfo

    (root / "color").mkdir(parents=True)
    frames = []
    for i, path in enumerate(sorted(images.iterdir())):
        shutil.copyfile(path, root / "color" / path.name)
        frames.append(Frame(id=i, name=path.stem, color=f"color/{path.name}"))
    width, height = image_size(root / frames[0].color)
    fx, fy, cx, cy = (float(K[i]) for i in ((0, 0), (1, 1), (0, 2), (1, 2)))
    camera = CameraModel(width=width, height=height, fx=fx, fy=fy, cx=cx, cy=cy)
    return Scene.create(
        root, SceneInfo(name="perf", cameras={"color": camera}), Frames(frames=frames)
    )


def processor_seconds() -> float:
    """Processor time of this process and its children, running ones with those they waited for."""
    from std_toolkit.jobs.guard import children_of

    ended = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    ticks = 0
    for child in children_of(os.getpid()):
        fields = Path(f"/proc/{child}/stat").read_text().rpartition(")")[2].split()
        ticks += sum(map(int, fields[11:15]))
    return sum(u.ru_utime + u.ru_stime for u in ended) + ticks / os.sysconf("SC_CLK_TCK")


def plain(images: Path, K: np.ndarray, work: Path, *, exhaustive: bool) -> tuple[float, float, int]:
    """(seconds, processor seconds, registered frames) of pycolmap with default options."""
    import pycolmap

    from std_toolkit.poses.colmap import quiet_colmap

    work.mkdir()
    reader = pycolmap.ImageReaderOptions()
    reader.camera_model = "PINHOLE"
    reader.camera_params = f"{K[0, 0]},{K[1, 1]},{K[0, 2] + 0.5},{K[1, 2] + 0.5}"
    mapping = pycolmap.IncrementalPipelineOptions()
    mapping.ba_refine_focal_length = False
    mapping.ba_refine_extra_params = False
    start, before = time.perf_counter(), processor_seconds()
    with quiet_colmap():
        pycolmap.extract_features(
            work / "d.db",
            images,
            camera_mode=pycolmap.CameraMode.SINGLE,
            reader_options=reader,
        )
        (pycolmap.match_exhaustive if exhaustive else pycolmap.match_sequential)(work / "d.db")
        models = pycolmap.incremental_mapping(work / "d.db", images, work, mapping)
    seconds, busy = time.perf_counter() - start, processor_seconds() - before
    return seconds, busy, max((m.num_reg_images() for m in models.values()), default=0)


def seconds_per_further_frame(scene: Any, work: Path) -> float:
    """Extraction and registration of every frame against the finished map, per frame."""
    import pycolmap

    from std_toolkit.io.documents import read_document
    from std_toolkit.jobs import JobOptions
    from std_toolkit.poses import PoseOptions
    from std_toolkit.poses.colmap import Reconstruction, image_id_of, quiet_colmap
    from std_toolkit.poses.features import (
        FeatureJob,
        describe_image,
        extract_features,
        load_features,
        train_vocabulary,
    )
    from std_toolkit.poses.register import RegistrationJob, build_index, register_frames

    options, jobs = PoseOptions(), JobOptions(progress=False)
    stored = next((scene.root / ".std" / "poses").glob("model-*"))
    about = read_document(stored / "about.json", Reconstruction)
    with quiet_colmap():
        model = pycolmap.Reconstruction(stored / "sparse")
    camera = scene.camera(scene.frames[0])
    start = time.perf_counter()
    extract_features(
        [FeatureJob(f.name, scene.color_path(f), camera.size, False) for f in scene.frames],
        work / "features",
        max_features=options.max_features,
        options=jobs,
    )
    extraction = time.perf_counter() - start
    keyframes = [scene.frame(i) for i in about.keyframes]
    descriptors = [load_features(work / "features", f.name).descriptors for f in keyframes]
    vocabulary = train_vocabulary(descriptors, seed=0)
    vectors = {
        image_id_of(f): describe_image(d, vocabulary)
        for f, d in zip(keyframes, descriptors, strict=True)
    }
    order = {f.id: i for i, f in enumerate(scene.frames)}
    index = build_index(
        model, [(image_id_of(f), f.name, order[f.id]) for f in keyframes], vectors, vocabulary
    )
    index.save(work / "index.npz")
    start = time.perf_counter()
    report = register_frames(
        [RegistrationJob(f.name, order[f.id], camera) for f in scene.frames],
        work / "index.npz",
        work / "features",
        min_points=options.min_points,
        seed=0,
        options=jobs,
    )
    report.raise_if_failed()
    return (extraction + time.perf_counter() - start) / len(scene.frames)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--images", type=Path, default=DATA / "tabletop_board_rgb" / "color")
    parser.add_argument(
        "--intrinsics", type=Path, default=DATA / "tabletop_board_rgb" / "cam_intrinsics.json"
    )
    parser.add_argument("--skip-exhaustive", action="store_true")
    args = parser.parse_args()
    from std_toolkit.poses import PoseOptions
    from std_toolkit.poses.pose_step import estimate_poses

    K = np.array(json.loads(args.intrinsics.read_text())["K"])
    with tempfile.TemporaryDirectory() as folder:
        work = Path(folder)
        scene = make_scene(args.images, K, work / "scene")
        start, before = time.perf_counter(), processor_seconds()
        poses = estimate_poses(scene, PoseOptions(scale="none"))
        ours, busy = time.perf_counter() - start, processor_seconds() - before
        registered = sum(p.status == "registered" for p in poses.frames)
        total = len(scene.frames)

        def show(name: str, seconds: float, used: float, count: int) -> None:
            print(
                f"{name:18} {seconds:8.1f} {ours / seconds:10.2f} {used:8.1f} {busy / used:10.2f} "
                f"{count:6} of {total}",
                flush=True,
            )

        print(f"{'':18} {'seconds':>8} {'ours / it':>10} {'busy':>8} {'ours / it':>10} registered")
        show("std-curate poses", ours, busy, registered)
        show("plain sequential", *plain(args.images, K, work / "s", exhaustive=False))
        if not args.skip_exhaustive:
            show("plain exhaustive", *plain(args.images, K, work / "e", exhaustive=True))
        further = seconds_per_further_frame(scene, work)
    cores = len(os.sched_getaffinity(0))
    print(f"each further frame that is no keyframe: {further:.3f} s on {cores} cores")


if __name__ == "__main__":
    main()
