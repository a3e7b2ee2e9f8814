"""Manifests of runs: the setup that determines a table, and the environment of the run."""

import platform
import sys
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Annotated, Any, Literal

import msgspec

from std_toolkit import __version__
from std_toolkit.options import usable_cores

# Names that tables, pages and terminals show. Results may come from somebody else.
Name = Annotated[str, msgspec.Meta(max_length=300, pattern=r'^[^\x00-\x1f\x7f<>"]*$')]

Count = Annotated[int, msgspec.Meta(ge=0)]

MANIFEST = "run.json"

_PACKAGES = ("numpy", "opencv-python-headless", "pandas", "pyarrow", "scipy", "torch")

GRASP_MANIFEST = "grasp.json"

DUMP_MANIFEST = "grasp_dump.json"

POSE_MANIFEST = "pose.json"

ORDER_MANIFEST = "order.json"

BOP_MANIFEST, BOP_FILE = "bop_run.json", "bop.json"


class _Frames(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Fields that determine the table of a method on frames.

    Attributes:
        split: name of the split.
        frames: number of frames.
        frames_sha256: SHA-256 hash of the frame names.
        method, preset, settings: the method and its options.
        weights_sha256: hash of the weight file (128-bit BLAKE2b, in spite of the name); empty
            without a weight file.
        precision, compile, device: options of the network; device is its type, `cpu` or `cuda`.
    """

    split: Name
    frames: Count
    frames_sha256: str
    method: str
    preset: str
    settings: dict[str, str]
    weights_sha256: str
    precision: str
    compile: bool
    device: str


class Setup(_Frames, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Fields that determine the table of a run; a run resumes only if they are unchanged.

    Attributes:
        protocol: the scoring protocol.
        batch_size: frames that are passed to the method together.
        depth_from: folder of the depth that replaces the sensor depth; empty for sensor depth.
        depth_unit: stated metres per number of its files; 0 if their type tells it.
        released_loader: batch size of the authors' loader, if frames are read as it does; else 0.
        probes: what the method was run again for: `holes`, `color`.
        limits: of `std-restore` and of metrics that differ from the defaults, by name.
        backend: what ran the networks of `std-restore`: `onnx` or `torch`; empty for other methods,
            whose networks torch runs.
    """

    protocol: Name
    batch_size: Count
    depth_from: str
    depth_unit: float = 0.0
    released_loader: Count = 0
    probes: list[str] = []
    limits: dict[str, float] = {}
    backend: Literal["", "onnx", "torch"] = ""


class _Run(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Environment of a run, informative only.

    Attributes:
        version_of_tool: version of this package.
        packages: versions of the numerical libraries.
        hardware: processor, cores and GPUs.
    """

    version_of_tool: str
    packages: dict[str, str]
    hardware: dict[str, str]


class Manifest(_Run, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Setup and environment of a run; the environment is informative only.

    Attributes:
        label: name of the method in tables.
        root: folder of the data.
        weights: path of the weight file, as given.
        training_data: what the weights were trained on; "" if nothing beside them says so.
        training_seed: that they were trained with; None if nothing beside them says so.
    """

    label: Name
    setup: Setup
    root: str
    weights: str
    training_data: str = ""
    training_seed: int | None = None


def circumstances() -> dict[str, Any]:
    """Return the environment fields of a manifest."""
    return {
        "version_of_tool": __version__,
        "packages": package_versions(),
        "hardware": hardware(),
    }


def package_versions() -> dict[str, str]:
    """Return the versions of Python and of the installed numerical libraries."""
    found = {"python": platform.python_version()}
    for name in _PACKAGES:
        try:
            found[name] = version(name)
        except PackageNotFoundError:
            continue
    return found


def hardware() -> dict[str, str]:
    """Return the processor, the usable cores, and, if torch is imported, its GPUs."""
    found = {"processor": _processor(), "cores": str(usable_cores())}
    torch = sys.modules.get("torch")
    if torch is not None and torch.cuda.is_available():
        names = [torch.cuda.get_device_name(i) for i in range(torch.cuda.device_count())]
        found["gpus"] = ", ".join(names)
    return found


def _processor() -> str:
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
    except OSError:
        lines = []
    names = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
    return names[0] if names else platform.processor() or platform.machine()


class GraspSetup(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Fields that determine the table of a run; a run resumes only if they are unchanged.

    Rounds may be added.

    Attributes:
        seed: seed of all rounds.
        attempts: maximum number of attempts per round.
        camera: `quick` or `simulated`.
        depth_model_sha256: hash (128-bit BLAKE2b) of the fitted parameters of the quick camera;
            empty for `simulated`.
        gripper: name of the gripper.
        move: `guarded` or `straight`, see `benchmark.tabletop.grasp`.
        meshes, meshes_sha256, meshes_unit: name of the user's folder of meshes, SHA-256 hash of
            the names and contents of its files, and its unit; empty for the built-in shapes.
        scenes, scenes_sha256: name of the user's folder of scenes, and SHA-256 hash of their
            documents and meshes; empty for objects that are dropped.
        planner, planner_preset, planner_settings, planner_weights_sha256: the planner and its
            options.
        depth, depth_preset, depth_settings, depth_weights_sha256: `raw` or `gt`, which have no
            preset, a restorer and its options, or the name of a folder.
        depth_folder: folder of saved depth; otherwise empty.
        precision, compile, device: options of networks; device is its type, `cpu` or `cuda`.
        limits: limits that differ from the defaults, see `std_toolkit.settings.changed`.
    """

    limits: dict[str, float] = {}
    seed: int
    attempts: Count
    camera: Name
    depth_model_sha256: str
    gripper: Name
    planner: Name
    planner_preset: str
    planner_settings: dict[str, str]
    planner_weights_sha256: str
    depth: str
    depth_preset: str
    depth_settings: dict[str, str]
    depth_weights_sha256: str
    precision: str
    compile: bool
    device: str
    move: str = "straight"
    depth_folder: str = ""
    meshes: Name = ""
    meshes_sha256: str = ""
    meshes_unit: str = ""
    scenes: Name = ""
    scenes_sha256: str = ""


class GraspManifest(_Run, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Setup and environment of a run; the environment is informative only.

    Attributes:
        depth_label, planner_label: names of depth and planner in tables.
        planner_weights, depth_weights: paths of the weight files, as given.
        planner_training_data, depth_training_data: what they were trained on; "" if nothing beside
            them says so.
        planner_training_seed, depth_training_seed: that they were trained with; None if nothing
            beside them says so.
    """

    depth_label: Name
    planner_label: Name
    setup: GraspSetup
    planner_weights: str
    depth_weights: str
    planner_training_data: str = ""
    depth_training_data: str = ""
    planner_training_seed: int | None = None
    depth_training_seed: int | None = None


class DumpSetup(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Fields that determine the table of a dump; a run resumes only if they are unchanged.

    Attributes:
        split: `test`, `seen`, `similar` or `novel`.
        camera: `realsense` or `kinect`.
        contacts: `exact` or `sdf`, see `benchmark.metrics.grasp.ap`.
        frames: number of annotated images.
    """

    split: Name
    camera: Name
    contacts: Name
    frames: Count


class DumpManifest(_Run, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Setup and environment of a run; the environment is informative only.

    Attributes:
        label: name of the grasps in tables.
        root, dump: folders of the data set and of the grasps.
    """

    label: Name
    setup: DumpSetup
    root: str
    dump: str


class OrderSetup(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Fields that determine the table of a run; a run resumes only if they are unchanged.

    Attributes:
        split: `layered-depth`.
        subset: `layer_first` or `layer_all`.
        frames: number of photos.
        frames_sha256: SHA-256 hash of their names.
        layers: how files count layers: `odd` (1, 3, 5, 7) or `counted` (0, 1, 2, 3).
        npy: what .npy holds: `inverse` depth, or `depth`.
    """

    split: Literal["layered-depth"]
    subset: Literal["layer_first", "layer_all"]
    frames: Count
    frames_sha256: str
    layers: Literal["odd", "counted"]
    npy: Literal["inverse", "depth"]


class OrderManifest(_Run, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Setup and environment of a run; the environment is informative only.

    Attributes:
        label: name of the predictions in tables.
        root, predictions: folders of the photos and of the predictions.
    """

    label: Name
    setup: OrderSetup
    root: str
    predictions: str


class PoseSetup(_Frames, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Fields that determine the table of a run; a run resumes only if they are unchanged.

    The settings include the fit.

    Attributes:
        batch_size: frames that are passed to the method together.
        depth: depth that poses are fitted to: `raw`, `gt`, a restorer, or the name of a folder.
        depth_preset, depth_settings, depth_weights_sha256: options of the restorer; otherwise
            empty.
        depth_folder: folder of saved depth; otherwise empty.
        as_input: whether networks also receive that depth instead of raw depth.
        given_truth: whether the method receives ground truth.
    """

    batch_size: Count
    depth: str
    depth_preset: str
    depth_settings: dict[str, str]
    depth_weights_sha256: str
    depth_folder: str
    as_input: bool
    given_truth: bool


class PoseManifest(_Run, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Setup and environment of a run; the environment is informative only.

    Attributes:
        label, depth_label, fit: names of method, depth and fit in tables.
        root: folder of the data.
        weights, depth_weights: paths of the weight files, as given.
        training_data, depth_training_data: what they were trained on; "" if nothing beside them
            says so.
        training_seed, depth_training_seed: that the weights were trained with; None if nothing
            beside them says so.
    """

    label: Name
    depth_label: Name
    fit: Name
    setup: PoseSetup
    root: str
    weights: str
    depth_weights: str
    training_data: str = ""
    depth_training_data: str = ""
    training_seed: int | None = None
    depth_training_seed: int | None = None


class BopSetup(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Fields that determine the table of a run; a run resumes only if they are unchanged.

    Attributes:
        data, split: folder names of the data set and of its scenes.
        results, results_sha256: name of the result file, and its SHA-256 hash.
        targets, targets_sha256: number of targets (objects in images), and their SHA-256 hash.
        renderer: renderer of the models for VSD.
        sensors: chosen sensors of data sets with several.
        errors: errors that are scored.
        symmetry_steps: samples of a turn about a continuous axis; None for the exact minimum.
        vsd_delta_mm: tolerance of visibility in VSD.
        multi_view: whether images are those of the multi-view targets.
        columns: version of the table; 1 of results without detection.
    """

    data: Name
    split: Name
    results: Name
    results_sha256: str
    targets: Count
    targets_sha256: str
    renderer: Name
    sensors: tuple[str, ...] = ()
    errors: tuple[str, ...] = ("vsd", "mssd", "mspd")
    symmetry_steps: Count | None = None
    vsd_delta_mm: float = 15.0
    multi_view: bool = False
    columns: Count = 1


class BopManifest(_Run, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Setup and environment of a run; the environment is informative only.

    Attributes:
        root: folder of the data.
    """

    setup: BopSetup
    root: str
