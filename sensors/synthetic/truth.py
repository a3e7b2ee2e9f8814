"""Uses of a recording's ground truth: first-frame poses, a labelled scene, label errors.

First-frame poses have the error of a human annotator. The labelled scene has exact poses and
labels, for tests of single steps.
"""

import shutil
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from sensors.output.recording_writer import Truth, read_truth
from std_toolkit.errors import ToolkitError
from std_toolkit.geometry import SE3, mssd, rotation_error, so3_exp, translation_error
from std_toolkit.geometry.mesh import hull_vertices, load_mesh, mesh_diameter, mesh_extents
from std_toolkit.io.atomic import atomic_path
from std_toolkit.scene import model
from std_toolkit.scene.scene import Scene


@dataclass(frozen=True)
class LabelErrors:
    """Errors over all labelled frames, one entry per frame.

    Attributes:
        mssd_m: by object name, metres.
        translation_m: by object name, metres.
        rotation_rad: by object name, radians, symmetry aware.
    """

    mssd_m: dict[str, list[float]]
    translation_m: dict[str, list[float]]
    rotation_rad: dict[str, list[float]]

    def percentile_mm(self, q: float) -> float:
        """Percentile of the MSSD over all objects and frames, millimetres."""
        return 1000 * float(np.percentile(np.concatenate(list(self.mssd_m.values())), q))

    def table(self) -> str:
        """One row per object and one for all, as text."""
        head = ("frames", 7), ("median mm", 11), ("p95 mm", 9), ("shift mm", 10), ("turn deg", 10)
        rows = [f"{'object':<14}" + "".join(f"{name:>{width}}" for name, width in head)]
        for name, values in self.mssd_m.items():
            mm = 1000 * np.asarray(values)
            shift = 1000 * np.median(self.translation_m[name])
            turn = np.degrees(np.median(self.rotation_rad[name]))
            rows.append(
                f"{name:<14}{len(mm):>7}{np.median(mm):>11.2f}{np.percentile(mm, 95):>9.2f}"
                f"{shift:>10.2f}{turn:>10.2f}"
            )
        count = sum(len(v) for v in self.mssd_m.values())
        rows.append(
            f"{'all':<14}{count:>7}{self.percentile_mm(50):>11.2f}{self.percentile_mm(95):>9.2f}"
        )
        return "\n".join(rows)


def label_errors(scene: Scene, recording: Path) -> LabelErrors:
    """Errors of a scene's propagated labels, in camera frames so that no alignment is needed.

    Raises:
        ToolkitError: an object or all of its frames have no label.
    """
    truth = read_truth(recording)
    index_of = {name: i for i, name in enumerate(truth.frames)}
    errors = LabelErrors({}, {}, {})
    for item in truth.objects:
        label_object = scene.objects.object_named(item.name)
        hull = hull_vertices(load_mesh(recording / item.mesh))
        symmetry = item.symmetry.symmetry()
        rows = []
        for frame in scene.frames:
            estimate = scene.T_cam_obj(frame.id, label_object.id)
            if estimate is None:
                continue
            exact = truth.camera_pose(index_of[frame.name]).inverse() @ truth.object_pose(item.name)
            rows.append(
                (
                    mssd(estimate, exact, hull, symmetry, steps=180),
                    translation_error(estimate, exact),
                    rotation_error(estimate, exact, symmetry),
                )
            )
        if not rows:
            raise ToolkitError("no frame has a label", path=scene.root, field=item.name)
        for table, column in zip(
            (errors.mssd_m, errors.translation_m, errors.rotation_rad),
            zip(*rows, strict=True),
            strict=True,
        ):
            table[item.name] = list(column)
    return errors


def annotate_first_frame(
    truth: Truth,
    *,
    frame: int = 0,
    extents_m: dict[str, float],
    pixels: float = 1.0,
    degrees: float = 1.0,
    seed: int = 0,
) -> dict[str, SE3]:
    """T_cam_obj of every object in one frame, with an annotator's error.

    The lateral error is `pixels` (standard deviation per axis). The error along the viewing ray
    changes the size of the silhouette by `pixels`: at 0.7 m and f = 600 px one pixel on an object
    of 100 mm is 1.2 mm sideways but 8 mm in depth.

    Args:
        extents_m: size of each object across the view, metres, by name.
    """
    rng = np.random.default_rng(seed)
    T_cam_world = truth.camera_pose(frame).inverse()
    f = truth.camera.fx
    labels = {}
    for item in truth.objects:
        exact = T_cam_world @ SE3.from_matrix(item.T_world_obj)
        z = exact.t[2]
        sideways = rng.normal(0, pixels, 2) * z / f
        along = rng.normal(0, pixels) * z / f * z / extents_m[item.name]
        ray = exact.t / z
        axis = rng.normal(size=3)
        turn = so3_exp(axis / np.linalg.norm(axis) * np.radians(rng.normal(0, degrees)))
        labels[item.name] = SE3(turn @ exact.R, exact.t + along * ray + np.array([*sideways, 0.0]))
    return labels


def write_annotations(truth: Truth, recording: Path) -> dict[str, Path]:
    """The simulated first-frame poses as files for `std-curate label --pose`.

    Returns:
        By object name, `recording/annotation/NAME.txt`: T_cam_obj in frame 0, 4x4, metres.
    """
    extents = {
        item.name: float(np.max(load_mesh(recording / item.mesh).extents)) for item in truth.objects
    }
    paths = {}
    for name, pose in annotate_first_frame(truth, extents_m=extents).items():
        paths[name] = recording / "annotation" / f"{name}.txt"
        with atomic_path(paths[name]) as temporary:
            np.savetxt(temporary, pose.matrix(), fmt="%.9f")
    return paths


def scene_from_truth(recording: Path, out: Path) -> Scene:
    """Write a scene with the recording's images, true camera poses and true labels."""
    truth = read_truth(recording)
    for folder in ("color", "depth"):
        shutil.copytree(recording / folder, out / folder)
    for item in truth.objects:
        target = out / "models" / item.name / Path(item.mesh).name
        target.parent.mkdir(parents=True)
        shutil.copyfile(recording / item.mesh, target)
    info = model.SceneInfo(
        name=recording.name,
        cameras={"color": truth.camera},
        depth_scale=truth.depth_scale,
        source="synthetic:truth",
    )
    frames = [
        model.Frame(id=i, name=name, color=f"color/{name}.png", depth=f"depth/{name}.png")
        for i, name in enumerate(truth.frames)
    ]
    scene = Scene.create(out, info, model.Frames(frames=frames), _objects(truth, recording))
    scene.save_poses(
        model.CameraPoses(
            frames=[
                model.FramePose(frame=i, status="registered", T_world_cam=T)
                for i, T in enumerate(truth.T_world_cam)
            ],
            source="truth",
        )
    )
    T_cam_world = truth.camera_pose(0).inverse()
    scene.save_labels(
        model.Labels(
            labels=[
                model.Label(
                    object=i,
                    frame=0,
                    T_cam_obj=(T_cam_world @ SE3.from_matrix(item.T_world_obj)).flat(),
                    T_world_obj=item.T_world_obj,
                    method="truth",
                )
                for i, item in enumerate(truth.objects, start=1)
            ]
        )
    )
    return scene


def _objects(truth: Truth, recording: Path) -> model.ObjectTable:
    models, objects = [], []
    for i, item in enumerate(truth.objects, start=1):
        mesh = load_mesh(recording / item.mesh)
        models.append(
            model.Model(
                id=item.name,
                mesh=f"models/{item.name}/{Path(item.mesh).name}",
                category=item.category,
                class_id=item.class_id,
                size_m=[float(x) for x in mesh_extents(mesh)],
                diameter_m=mesh_diameter(mesh),
                symmetry=item.symmetry,
            )
        )
        objects.append(model.Object(id=i, name=item.name, model=item.name, material=item.material))
    return model.ObjectTable(models=models, objects=objects)
