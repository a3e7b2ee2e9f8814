"""Folders of poses that other programs estimated, as they lie.

DIR/SCENE/FRAME.json or .pkl, and what `FrameFiles` finds; `results_SPLIT_SCENE_FRAME.pkl`, as the
evaluation of NOCS writes them. A file has the fields of `PosePrediction`, also with `pred_` before
their names: `class_ids` (or `classes`, their names), `RTs`, `scales` and `scores`.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from benchmark.data.identity import SAVED_POSES
from benchmark.data.prediction_files import FrameFiles
from benchmark.data.splits import FrameKey
from benchmark.metrics.pose.pose_frames import PosePrediction
from benchmark.metrics.pose.pose_protocol import DREDS_CLASSES
from std_toolkit.errors import ToolkitError
from std_toolkit.io.foreign_files import read_json
from std_toolkit.io.plain_pickle import array_in, read_pickle

_NAMES = {
    "class_ids": ("class_ids", "pred_class_ids"),
    "RT": ("RT", "RTs", "pred_RTs"),
    "sizes": ("sizes", "scales", "pred_scales"),
    "scores": ("scores", "pred_scores"),
}
_CLASSES = "classes"
_NOCS = "results_"


def read_poses(path: Path) -> PosePrediction:
    """Read the poses of a frame.

    Args:
        path: of a JSON file, or of a pickle of arrays, which is read without running anything.

    Returns:
        The predictions; without scores each counts 1.

    Raises:
        ToolkitError: missing, damaged, or no poses.
    """
    found = read_json(path) if path.suffix == ".json" else read_pickle(path)
    if not isinstance(found, Mapping):
        raise ToolkitError(
            "must hold fields by name", path=path, value=type(found).__name__, hint=_fields()
        )
    values: dict[str, Any] = {}
    for name, others in _NAMES.items():
        there = [other for other in others if other in found]
        if len(there) > 1:
            raise ToolkitError("one field under two names", path=path, field=", ".join(there))
        if there:
            values[name] = array_in(found[there[0]], path, there[0])
    if _CLASSES in found and "class_ids" not in values:
        values["class_ids"] = _ids(found[_CLASSES], path)
    lacking = [name for name in ("class_ids", "RT", "sizes") if name not in values]
    if lacking:
        raise ToolkitError("lacks a field", path=path, field=lacking[0], hint=_fields())
    ids = values["class_ids"].reshape(-1)
    if (ids != np.rint(ids)).any() or (abs(ids) > np.iinfo(np.int32).max).any():
        raise ToolkitError("must be whole numbers", path=path, field="class_ids")
    try:
        return PosePrediction(
            ids.astype(np.int64),
            values["RT"],
            values["sizes"],
            values.get("scores", np.ones(len(ids))),
        )
    except ToolkitError as error:
        raise error.revised(path=path) from None


def _ids(names: Any, path: Path) -> Any:
    """Numbers of classes that are named."""
    known = {name: number for number, name in enumerate(DREDS_CLASSES)}
    wrong = [name for name in names if name not in known] if isinstance(names, list) else [names]
    if wrong:
        raise ToolkitError(
            "not a list of known classes", path=path, field=_CLASSES, value=repr(wrong[0])[:40],
            hint=", ".join(DREDS_CLASSES),
        )  # fmt: skip
    return np.array([known[name] for name in names], dtype=np.float64)


def _fields() -> str:
    return "; ".join(" or ".join(names) for names in _NAMES.values())


@dataclass(frozen=True)
class PoseFolder(FrameFiles):
    """A folder of estimated poses; see `FrameFiles`."""

    content: ClassVar[str] = SAVED_POSES
    suffixes: ClassVar[tuple[str, ...]] = (".json", ".pkl", ".pickle")
    below: ClassVar[tuple[str, ...]] = ("", "poses")
    _ends: dict[str, list[str]] = field(default_factory=dict, repr=False, compare=False)

    def joined(self, key: FrameKey) -> Iterator[str]:
        """Also `results_SPLIT_SCENE_FRAME`, whose SPLIT is anything."""
        yield from super().joined(key)
        if not self._ends:
            for name in sorted(self._names_in(self.folder)):
                words = Path(name).stem.split("_")
                if name.startswith(_NOCS) and Path(name).suffix in self.suffixes:
                    for place in range(1, len(words)):
                        end = "_".join(words[place:])
                        self._ends.setdefault(end, []).append("_".join(words))
        yield from self._ends.get(f"{key.scene}_{key.name}", ())

    def read(self, key: FrameKey) -> PosePrediction:
        """Read the poses of a frame; see `read_poses`."""
        return read_poses(self.path(key))


def check_poses(answers: PoseFolder, keys: Sequence[FrameKey]) -> None:
    """Look for a file of any frame, and read the first.

    Raises:
        ToolkitError: no frame has a file, or it holds no poses.
    """
    there = next((key for key in keys if answers.path(key).is_file()), None)
    if there is None:
        raise ToolkitError(
            f"no file of any of the {len(keys)} frames",
            path=answers.folder,
            value=str(keys[0]),
            hint=f"expected {keys[0].scene}/{keys[0].name}.json or .pkl, or results_*.pkl; "
            "BOP's CSV files are scored by `std-bench bop`",
        )
    answers.read(there)
