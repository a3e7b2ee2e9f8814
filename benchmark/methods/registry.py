"""Registry and factory of methods: names, options, presets, settings and shipped weights.

Errors are one line that names the method and the field.
"""

import hashlib
import inspect
import traceback
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from typing import Any, Generic, Literal, TypeVar

from benchmark.methods.protocol import GraspPlanner, PoseEstimator, Restorer
from std_toolkit.errors import ToolkitError, check_known, missing_extra
from std_toolkit.io.documents import digest_file, digest_files, digest_of
from std_toolkit.plugins import Registry

T = TypeVar("T")

Config = TypeVar("Config")

PUBLISHED, COMPACT, SMALL = "published", "compact", "small"

COMMAND = "command:"

SHIPPED = Path(__file__).resolve().parent.parent / "weights"


@dataclass(frozen=True, kw_only=True)
class MethodOptions:
    """How to make a method.

    Attributes:
        preset: size of a network: `published` or `compact`; others ignore it.
        weights: file of trained weights; None for those that come with the toolkit.
        device: torch device, such as `cpu` or `cuda:0`.
        precision: of a network's arithmetic.
        compile: whether a network goes through `torch.compile`.
        settings: the method's own settings by name, as text.
    """

    preset: str = "published"
    weights: Path | None = None
    device: str = "cpu"
    precision: Literal["fp32", "bf16", "fp16"] = "fp32"
    compile: bool = False
    settings: Mapping[str, str] = field(default_factory=dict)


class MethodRegistry(Registry[Callable[[MethodOptions], T]], Generic[T]):
    """The methods of a task: classes and functions that take `MethodOptions`.

    Args:
        group: entry-point group.
        builtin: name to `package.module:Class`.
        called: the method that each must have.
        has: attributes that each must have.
        guide: the page that shows how one is written.
        command: class of a method that is a program, `command:PROGRAM ARGUMENTS`.
    """

    def __init__(
        self,
        group: str,
        builtin: dict[str, str],
        *,
        called: str,
        has: Sequence[str] = (),
        guide: str,
        command: str = "",
    ) -> None:
        super().__init__(group, builtin)
        self.called, self.has, self.guide, self.command = called, has, guide, command

    def get(self, name: str) -> Callable[[MethodOptions], T]:
        """As `Registry.get`; of `command:PROGRAM ARGUMENTS` the class that runs it."""
        return super().get(self.command if self.command and name.startswith(COMMAND) else name)

    def about(self, name: str) -> str:
        """A line about a method, or why it is not usable here."""
        try:
            return (inspect.getdoc(self.get(name)) or "").partition("\n")[0]
        except ToolkitError as error:
            return f"not usable here: {error.problem}"

    def make(self, name: str, options: MethodOptions | None = None) -> T:
        """A method by its name, by `package.module:Class`, by `file.py:Class`, or a program as
        `command:PROGRAM ARGUMENTS`.

        Raises:
            ToolkitError: no such method, one that lacks a part, or what it says of its options and
                weights.
        """
        factory = self.get(name)
        options = options or MethodOptions()
        if self.command and name.startswith(COMMAND):
            settings = {**options.settings, "command": name.removeprefix(COMMAND)}
            options = replace(options, settings=settings)
        if not callable(factory):
            raise ToolkitError(
                "is not a class that takes MethodOptions",
                value=name,
                hint=f"{self.guide} shows one",
            )
        try:
            method = factory(options)
        except (ToolkitError, MemoryError):
            raise
        except Exception as error:
            if (missing := missing_extra(error)) is not None:
                raise missing from error
            place = traceback.extract_tb(error.__traceback__)[-1]
            text = " ".join(str(error).split())
            raise ToolkitError(
                f"the method cannot be made: {type(error).__name__}: {text}",
                value=name,
                hint=f"raised in {place.filename}, line {place.lineno}",
            ) from error
        absent = [part for part in self.has if not hasattr(method, part)]
        absent += [] if callable(getattr(method, self.called, None)) else [self.called]
        if absent:
            raise ToolkitError(
                "the method has no such attribute",
                field=", ".join(absent),
                value=name,
                hint=f"{self.guide} tells what a method must have",
            )
        return method


restorers: MethodRegistry[Restorer] = MethodRegistry(
    "std_toolkit.restorers",
    {
        "raw": "benchmark.methods.depth.filling.filler:Raw",
        "nearest": "benchmark.methods.depth.filling.filler:Nearest",
        "navier-stokes": "benchmark.methods.depth.filling.inpainting:NavierStokes",
        "telea": "benchmark.methods.depth.filling.inpainting:Telea",
        "joint-bilateral": "benchmark.methods.depth.filling.inpainting:JointBilateral",
        "colorization": "benchmark.methods.depth.filling.colorization:Colorization",
        "planes": "benchmark.methods.depth.filling.planes:Planes",
        "stereo-local": "benchmark.methods.depth.stereo:StereoLocal",
        "stereo-sgbm": "benchmark.methods.depth.stereo:StereoSgbm",
        "stereo-dreds": "benchmark.methods.depth.stereo:StereoDreds",
        "compactdr": "benchmark.methods.depth.compactdr:CompactDR",
        "swindrnet": "benchmark.methods.depth.swindrnet.swindrnet:SwinDRNet",
        "nlspn": "benchmark.methods.depth.nlspn:NLSPN",
        "lidf": "benchmark.methods.depth.lidf.lidf:LIDF",
        "cleargrasp": "benchmark.methods.depth.cleargrasp.cleargrasp:ClearGrasp",
        "dfnet": "benchmark.methods.depth.dfnet:DFNet",
        "two-branch": "benchmark.methods.depth.two_branch:TwoBranch",
        "std-restore": "benchmark.restoring.as_method:ByDefault",
        "onnx": "benchmark.methods.depth.onnx_network:OnnxNetwork",
        "prompt-depth-anything": "benchmark.methods.depth.snapshot:PromptDepthAnything",
        "depth-anything": "benchmark.methods.depth.snapshot:DepthAnything",
        "depth-pro": "benchmark.methods.depth.snapshot:DepthPro",
        "zoedepth": "benchmark.methods.depth.snapshot:ZoeDepth",
    },
    called="restore",
    has=("input_size", "needs_mask"),
    guide="docs/methods.md",
    command="benchmark.methods.depth.command:CommandRestorer",
)


pose_methods: MethodRegistry[PoseEstimator] = MethodRegistry(
    "std_toolkit.pose_methods",
    {
        "gt-nocs": "benchmark.methods.pose.ground_truth:GroundTruthNOCS",
        "swindrnet-nocs": "benchmark.methods.pose.swindrnet_nocs.swindrnet_nocs:SwinDRNetNOCS",
        "nocs": "benchmark.methods.pose.nocs.nocs:NOCS",
        "crop-nocs": "benchmark.methods.pose.crop_nocs:CropNOCS",
        "spd": "benchmark.methods.pose.spd:SPD",
        "sgpa": "benchmark.methods.pose.sgpa:SGPA",
    },
    called="estimate",
    has=("input_size", "needs_truth"),
    guide="docs/pose.md",
    command="benchmark.methods.pose.command:CommandMethod",
)

grasp_planners: MethodRegistry[GraspPlanner] = MethodRegistry(
    "std_toolkit.grasp_planners",
    {
        "antipodal": "benchmark.methods.grasp.antipodal.antipodal:Antipodal",
        "flat-patches": "benchmark.methods.grasp.flat_patches:FlatPatches",
        "graspnet": "benchmark.methods.grasp.graspnet.graspnet:GraspNet",
    },
    called="plan",
    guide="docs/grasp_methods.md",
)

# By task.
METHODS: dict[str, MethodRegistry[Any]] = {
    "depth": restorers,
    "pose": pose_methods,
    "grasp": grasp_planners,
}


def has_setting(name: str, setting: str) -> bool:
    """Whether a method has a setting; of methods that do not tell theirs it is not known to.

    A method tells by `settings_type`, the dataclass of its settings.

    Raises:
        ToolkitError: the method cannot be imported.
    """
    found = [r for r in METHODS.values() if name in r.names()]
    if name.startswith(COMMAND):
        found = [r for r in METHODS.values() if r.command]
    elif not found and ":" in name:
        found = [restorers]  # any finds a class by its place
    kinds = [getattr(registry.get(name), "settings_type", None) for registry in found]
    return any(k is not None and setting in {f.name for f in fields(k)} for k in kinds)


def make_restorer(name: str, options: MethodOptions | None = None) -> Restorer:
    """A depth restorer; see `MethodRegistry.make`."""
    return restorers.make(name, options)


def make_pose_method(name: str, options: MethodOptions | None = None) -> PoseEstimator:
    """A pose method; see `MethodRegistry.make`. `command:PROGRAM ARGUMENTS` runs a program."""
    return pose_methods.make(name, options)


def make_planner(name: str, options: MethodOptions | None = None) -> GraspPlanner:
    """A grasp planner; see `MethodRegistry.make`."""
    return grasp_planners.make(name, options)


def preset_of(presets: Mapping[str, Config], name: str) -> Config:
    """One of a method's presets.

    Raises:
        ToolkitError: it has no such preset.
    """
    check_known(name, presets, "the method has no such preset", told="it has")
    return presets[name]


# Methods that join others, and run these as they ship.
JOINED = {"std-restore": ("swindrnet", "compactdr")}


def shipped_file(method: str, preset: str) -> Path:
    """Where weights that come with the toolkit would be."""
    if method.startswith(COMMAND):
        method = COMMAND  # a command is no name of a file
    return SHIPPED / f"{method}-{preset}.safetensors"


def shipped_weights(method: str, preset: str) -> Path:
    """The file of weights that comes with the toolkit.

    Its SHA-256 is in the file of the same name with `.sha256` behind, and is checked.

    Raises:
        ToolkitError: none comes for this preset, or the file is not what was shipped.
    """
    path = shipped_file(method, preset)
    if not path.is_file():
        raise ToolkitError(
            f"no weights for {method}, preset {preset}, come with the toolkit",
            hint="give --weights",
        )
    check_shipped(path, "weights")
    return path


def check_shipped(path: Path, what: str) -> None:
    """Check a file that comes with the toolkit by the SHA-256 beside it.

    Raises:
        ToolkitError: it is not what was shipped.
    """
    expected = path.with_name(path.name + ".sha256").read_text(encoding="ascii").split()[0]
    if sha256_of(path) != expected:
        raise ToolkitError(
            f"not the {what} that were shipped: their SHA-256 differs",
            path=path,
            hint="install the toolkit again",
        )


def shipped_graphs(method: str, preset: str) -> dict[tuple[int, int] | None, Path]:
    """The ONNX graphs that come with the toolkit, by (width, height), the smallest first.

    A graph for images of any size is called `METHOD-PRESET-any.onnx`; its size is None.

    They hold no weights: they refer to those of `shipped_file` beside them.
    """
    stem = f"{method}-{preset}-"
    found: dict[tuple[int, int] | None, Path] = {}
    # The name may be that of a user's file, and no pattern.
    for path in (path for path in SHIPPED.glob("*.onnx") if path.name.startswith(stem)):
        size = path.stem.removeprefix(stem)
        width, _, height = size.partition("x")
        found[None if size == "any" else (int(width), int(height))] = path
    return dict(sorted(found.items(), key=lambda entry: entry[0] or (0, 0)))


def sha256_of(path: Path) -> str:
    """SHA-256 of a file, in hexadecimal."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def preset_for(method: str, asked: str | None, weights: Path | None) -> str:
    """The preset that a network is made with.

    Args:
        method: its name.
        asked: what a user wants; None is `published`, but `compact` or `small` where no weights
            are given and the toolkit brings some of that size.
        weights: a user's own.
    """
    if asked is not None:
        return asked
    if weights is None:
        for preset in (COMPACT, SMALL):
            if all(shipped_file(m, preset).is_file() for m in JOINED.get(method, (method,))):
                return preset
    return PUBLISHED


def weights_digest(name: str, method: object, options: MethodOptions) -> str:
    """Return the hash of the weight file of a method, either given or shipped.

    Args:
        name: name of the method.
        method: the method; None if there is none, as for raw depth.
        options: options that the method was created with.

    Returns:
        128-bit BLAKE2b hash in hexadecimal (see `digest_file`); of several files and of a folder
        (its documents and safetensors), of all with their names; empty without weights.
    """
    if method is None:
        return ""
    # A user's method may use the file without a `weights` attribute.
    weights = getattr(method, "weights", None) or options.weights
    if weights is None and (shipped := shipped_file(name, options.preset)).is_file():
        weights = shipped
    if isinstance(weights, tuple):  # of the networks that a method joins
        return joined_digest(weights)
    if not isinstance(weights, Path):
        return ""
    if weights.is_dir():
        files = [p for s in ("*.json", "*.safetensors") for p in sorted(weights.glob(s))]
        return digest_of(digest_files(weights, files), versioned=False)
    return digest_file(weights)


def joined_digest(files: Sequence[Path]) -> str:
    """Hash of the weight files of a method that joins networks."""
    return digest_of(digest_files(files[0].parent, files), versioned=False)
