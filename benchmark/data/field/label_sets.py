"""Sets whose labels can be audited: splits that have poses, and every set in BOP's form."""

from pathlib import Path

from benchmark.data.coordinate_labels import CoordinateLabels
from benchmark.data.dreds_std import LayoutScenes
from benchmark.data.field.bop_frames import BopFrames
from benchmark.data.field.field_labels import BopLabels, FieldLabels, open_bop_labels
from benchmark.data.field.source import FieldFrames
from benchmark.data.labelled import MATERIALS, LabelledSet
from benchmark.data.splits import get_split
from std_toolkit.errors import ToolkitError
from std_toolkit.scene.model import Material

BOP = "bop"


def open_labels(
    root: Path, split: str, *, models: Path | None = None, material: Material | None = None
) -> LabelledSet:
    """Open the labels of a set.

    Args:
        root: folder of the set, or one above it.
        split: name of `std-bench list splits`, or "bop": any set in BOP's form.
        models: folder of meshes named after the models or their numbers, for sets without any.
        material: of all objects, for sets that do not state it.

    Raises:
        ToolkitError: no such split or folder, or a set without poses.
    """
    if not root.is_dir():
        raise ToolkitError("no such folder", path=root)
    if split == BOP:
        return open_bop_labels(root, models, material)
    source = get_split(split).open(root)
    if isinstance(source, LayoutScenes):
        return CoordinateLabels(source)
    if isinstance(source, BopFrames):
        name = material or MATERIALS[source.material]
        folder = models or source.root / "models"
        return BopLabels(source.index, folder, name, source.sensor, source.depth_unit)
    if isinstance(source, FieldFrames) and type(source).poses is not FieldFrames.poses:
        return FieldLabels(source, models, material)
    raise ToolkitError("this split has no labels that can be audited", field="split", value=split)
