"""A pose method that is a program: frames in, a BOP result file out.

For methods that run in an environment of their own, such as a container. The program gets a folder
in BOP's layout and writes `results.csv` into it; docs/pose.md describes both.
"""

import shutil
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import msgspec
import numpy as np
from numpy.typing import NDArray

from benchmark.methods.program import run_program, words_of_command
from benchmark.methods.protocol import Estimated, PoseView
from benchmark.methods.registry import MethodOptions
from benchmark.metrics.bop.bop_file import BopEstimate, read_bop_results
from benchmark.metrics.bop.bop_model import read_vertices
from benchmark.metrics.pose.pose_frames import PosePrediction
from benchmark.metrics.pose.pose_protocol import DREDS_CLASSES
from std_toolkit.errors import ToolkitError
from std_toolkit.geometry.se3 import nearest_rotation
from std_toolkit.io.documents import read_document, write_document
from std_toolkit.io.images import write_png
from std_toolkit.plugins import configured

RESULTS = "results.csv"

_FOLDER = "{folder}"
_SCENE = "test/000001"
_DEPTH_SCALE_MM = 0.1
_LARGEST = 65535
_ROUGH = 0.1  # rotations in BOP's files may be that far off


@dataclass(frozen=True, kw_only=True)
class CommandConfig:
    """Settings.

    Attributes:
        command: program and arguments, from the name of the method; `{folder}` is the folder,
            otherwise it is the last argument.
        data: folder of a BOP data set with models/; its dataset_info.json, as `std-curate export`
            writes it, tells the category of each obj_id. Model frames must be canonical.
        classes: class of each model, in the order of their numbers, in place of dataset_info.json.
        timeout_s: seconds after which the program is stopped.
        fit: accepted as of every pose method, without effect: the program fits the poses.
    """

    command: str = ""
    data: str = ""
    classes: tuple[int, ...] = ()
    timeout_s: float = 3600.0
    fit: str = "ransac"


class _Named(msgspec.Struct, frozen=True, kw_only=True):
    obj_id: int
    category: str = "other"


class _DatasetInfo(msgspec.Struct, frozen=True, kw_only=True):
    objects: list[_Named]


@dataclass(frozen=True, eq=False)
class _Box:
    """What is known of a model: class, centre (3,) and sides (3,) in its own frame, metres."""

    class_id: int
    centre: NDArray[np.float64]
    sides: NDArray[np.float64]


class CommandMethod:
    """Runs the program once for each batch of frames.

    Args:
        options: settings are those of `CommandConfig`.

    Raises:
        ToolkitError: no program, no models, an unknown setting, or models without a class.
    """

    settings_type = CommandConfig

    input_size: tuple[int, int] | None = None
    needs_truth = False

    def __init__(self, options: MethodOptions) -> None:
        self.config = configured(CommandConfig(), options.settings)
        words = words_of_command(self.config.command, _FOLDER)
        if not self.config.data:
            raise ToolkitError(
                "a command needs the models of its objects",
                field="data",
                hint="--set data=FOLDER, a data set in BOP's layout",
            )
        self.words = words
        self._root = Path(self.config.data)
        self._boxes = _boxes(self._root, self.config.classes)

    def estimate(self, views: Sequence[PoseView]) -> list[Estimated]:
        """See `PoseEstimator`.

        Raises:
            ToolkitError: the program fails, is stopped, or writes results that cannot be used.
        """
        if not views:
            return []
        with tempfile.TemporaryDirectory(prefix="std-command-") as name:
            folder = Path(name) / "frames"
            folder.mkdir()
            write_frames(folder, views, self._root / "models")
            words = [word.replace(_FOLDER, str(folder)) for word in self.words]
            hint = "--set timeout_s=SECONDS, or a smaller --batch-size"
            run_program(words, Path(name), self.config.timeout_s, hint=hint)
            path = folder / RESULTS
            if not path.is_file():
                raise ToolkitError(f"the command wrote no {RESULTS}", value=self.words[0])
            found = read_bop_results(path)
        for e in found:
            if e.obj_id not in self._boxes or not 0 <= e.im_id < len(views):
                raise ToolkitError(
                    f"{RESULTS} has an object or an image that was not given",
                    value=f"obj_id {e.obj_id}, im_id {e.im_id}",
                    hint=f"objects {', '.join(map(str, self._boxes))}; {len(views)} images",
                )
        return [
            self._estimated([e for e in found if e.im_id == number]) for number in range(len(views))
        ]

    def _estimated(self, found: Sequence[BopEstimate]) -> Estimated:
        kept = [(e, self._boxes[e.obj_id]) for e in found if self._boxes[e.obj_id].class_id]
        RT, sizes = [], []
        for e, box in kept:
            diagonal = float(np.linalg.norm(box.sides))
            M = np.eye(4)
            M[:3, :3] = diagonal * nearest_rotation(e.T_cam_obj.R, tolerance=_ROUGH)
            M[:3, 3] = e.T_cam_obj @ box.centre
            RT.append(M)
            sizes.append(box.sides / diagonal)
        prediction = PosePrediction(
            np.array([box.class_id for _, box in kept], dtype=np.int64),
            np.array(RT).reshape(-1, 4, 4),
            np.array(sizes).reshape(-1, 3),
            np.array([e.score for e, _ in kept]),
        )
        return Estimated(prediction)


def write_frames(folder: Path, views: Sequence[PoseView], models: Path) -> None:
    """Write views in BOP's layout: scene 1 of split test, image numbers from 0, and the models.

    Depth is that which poses are to be fitted to.

    Raises:
        ToolkitError: a file cannot be written.
    """
    scene = folder / _SCENE
    cameras, targets = {}, []
    for number, view in enumerate(views):
        name = f"{number:06d}.png"
        units = np.rint(view.depth.astype(np.float64) * (1000 / _DEPTH_SCALE_MM))
        units[units > _LARGEST] = 0
        for kind, picture in (("rgb", view.color), ("depth", units.astype(np.uint16))):
            (scene / kind).mkdir(parents=True, exist_ok=True)
            write_png(scene / kind / name, picture)
        cameras[str(number)] = {
            "cam_K": [float(x) for x in view.camera.K.ravel()],
            "depth_scale": _DEPTH_SCALE_MM,
        }
        targets.append({"scene_id": 1, "im_id": number})
    write_document(scene / "scene_camera.json", cameras)
    write_document(folder / "test_targets_bop24.json", targets)
    # A copy: a link would point outside of what a container sees.
    shutil.copytree(models, folder / "models")


def _boxes(root: Path, classes: Sequence[int]) -> dict[int, _Box]:
    paths = sorted((root / "models").glob("obj_*.ply"))
    if not paths:
        raise ToolkitError("no models of a BOP data set here", path=root / "models")
    numbers = [int(path.stem.removeprefix("obj_")) for path in paths]  # IPD's begin at 0
    named: dict[int, int] = dict(zip(numbers, classes, strict=False))
    info = root / "dataset_info.json"
    if not classes and info.is_file():
        rows = read_document(info, _DatasetInfo).objects
        known = {name: number for number, name in enumerate(DREDS_CLASSES)}
        named = {row.obj_id: known.get(row.category, 0) for row in rows}
    found = {}
    for path, number in zip(paths, numbers, strict=True):
        if number not in named or not 0 <= named[number] < len(DREDS_CLASSES):
            raise ToolkitError(
                "the class of the model is not known",
                path=path,
                hint=f"dataset_info.json, or --set classes=1,4,... of {', '.join(DREDS_CLASSES)}",
            )
        vertices = read_vertices(path)
        low, high = vertices.min(axis=0), vertices.max(axis=0)
        found[number] = _Box(named[number], (low + high) / 2, high - low)
    return found
