"""Label error against the truth of a synthetic recording."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from sensors.synthetic.recording import read_truth
from std_toolkit.errors import ToolkitError
from std_toolkit.geometry.mesh import hull_vertices, load_mesh
from std_toolkit.geometry.symmetry import mssd, rotation_error, translation_error
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
    """Errors of a scene's propagated labels; in camera frames, so that no alignment is needed.

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
