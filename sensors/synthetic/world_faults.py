"""Wrong labels of known size for an object of a scene, to loop over in studies.

for fault in label_faults(scene, object_id, seed=7):
    faulty = fault.apply(scene)  # a Scene in memory; files do not change
    fault.name, fault.kind, fault.size, fault.mssd_m
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from std_toolkit.checks.inject.faults import Fault, FaultyScene, apply_fault
from std_toolkit.checks.measure.contours import object_centre
from std_toolkit.geometry import mssd
from std_toolkit.geometry.mesh import hull_vertices
from std_toolkit.scene import Scene

FaultKind = Literal["sideways", "along", "up", "turn", "tilt", "half", "quarter", "over"]
SHIFTS: tuple[FaultKind, ...] = ("sideways", "along", "up")
ROTATIONS: tuple[FaultKind, ...] = ("turn", "tilt")

MM, DEG = (4.0, 8.0, 12.0), (3.0, 5.0, 8.0)
# A displacement that symmetry undoes up to this is no fault.
NO_FAULT_M = 0.0015
UP = (0.0, 0.0, 1.0)


@dataclass(frozen=True)
class LabelFault:
    """One wrong label.

    Attributes:
        kind: "sideways" and "along" the view and "up" are translations; "turn" is about the
            vertical, "tilt" about the horizontal across the view, both through the object's centre;
            "half" and "quarter" are turns by 180 and 90 degrees, "over" is a tilt by 180.
        size: signed, mm or degrees.
        level: 0, 1 or 2: 4 mm or 3 deg, 8 mm or 5 deg, 12 mm or 8 deg; 3: half, quarter, over.
        mssd_m: largest displacement of a surface point, symmetry aware.
        fault: how it is made.
    """

    kind: FaultKind
    size: float
    level: int
    mssd_m: float
    fault: Fault

    @property
    def name(self) -> str:
        """In words, such as "sideways -8 mm"."""
        unit = "mm" if self.fault.name in ("sideways", "along") else "deg"
        return f"{self.kind} {self.size:g} {unit}"

    def apply(self, scene: Scene) -> FaultyScene:
        """The scene with this label."""
        return apply_fault(scene, self.fault)


def label_faults(
    scene: Scene,
    object_id: int,
    *,
    seed: int = 0,
    mm: Sequence[float] = MM,
    degrees: Sequence[float] = DEG,
) -> Iterator[LabelFault]:
    """Wrong labels of an object whose label is right; those that symmetry undoes are left out.

    Args:
        scene: with right labels and camera poses; its z axis points up.
        object_id: of the object.
        seed: of the signs.
        mm, degrees: sizes, one level each.
    """
    rng = np.random.default_rng([seed, object_id])
    positions = [scene.T_world_cam(f.id).t for f in scene.registered_frames()]  # type: ignore[union-attr]
    along = object_centre(scene, object_id) - np.mean(positions, axis=0)
    x, y, z = (float(v) for v in along / np.linalg.norm(along))
    hull = hull_vertices(scene.mesh(scene.objects.object(object_id).model))
    symmetry = scene.objects.model_of(object_id).symmetry.symmetry()
    right = scene.T_world_obj(object_id)
    assert right is not None
    trials: list[tuple[FaultKind, float, int]] = []
    for level, (distance, angle) in enumerate(zip(mm, degrees, strict=True)):
        trials += [(kind, distance, level) for kind in SHIFTS]
        trials += [(kind, angle, level) for kind in ROTATIONS]
    trials += [("half", 180.0, 3), ("quarter", 90.0, 3), ("over", 180.0, 3)]
    for kind, size, level in trials:
        signed = size * float(rng.choice([-1, 1]))
        fault = _fault(kind, signed, object_id, (x, y, z))
        wrong = apply_fault(scene, fault).T_world_obj(object_id)
        assert wrong is not None
        moved = mssd(wrong, right, hull, symmetry, steps=90)
        if moved > NO_FAULT_M:
            yield LabelFault(kind, signed, level, moved, fault)


def _fault(kind: FaultKind, size: float, object_id: int, view: tuple[float, float, float]) -> Fault:
    if kind == "up":
        return Fault("along", size, object_id, up=UP, along=UP)
    name = {"half": "turn", "quarter": "turn", "over": "tilt"}.get(kind, kind)
    return Fault(name, size, object_id, up=UP, along=view)  # type: ignore[arg-type]
