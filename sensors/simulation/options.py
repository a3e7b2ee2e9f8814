"""Options of a simulated set and the named presets; they import nothing heavy."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any, Literal, get_args

import msgspec

from std_toolkit.cli.command_options import words_of
from std_toolkit.errors import CheckedOptions, ToolkitError, check_options
from std_toolkit.jobs.door import Writes
from std_toolkit.options import JobOptions, Seed

Count = Annotated[int, msgspec.Meta(ge=1)]
# A scene's files are numbered with four digits; infrared cameras have up to two megapixels.
Views = Annotated[int, msgspec.Meta(ge=1, le=9999)]
Elevation = Annotated[float, msgspec.Meta(ge=0, lt=90)]
Pixels = Annotated[int, msgspec.Meta(ge=1, le=8192)]

Layout = Literal["dreds", "novel", "scene"]

ViewOrder = Literal["random", "arc", "spiral"]

Factor = Literal["objects", "materials", "lighting", "background", "camera"]

DepthInput = Literal["sensor", "cut", "exact"]

MaterialSwitch = Literal["mixed", "clear", "fixed", "opaque"]

# Where scenes come from; anything else is a folder of labelled scenes.
DROP, GRASPNET = "drop", "graspnet"

TwinName = Literal["glass", "steel", "matt", "original"]

QualityName = Literal["rough", "draft", "better", "fine"]

PresetName = Literal["draft", "tiny", "dreds"]

Collision = Literal["parts", "coarse"]

ObjectPoses = Literal["any", "upright", "mixed"]

TurntableMaterial = Literal["own", "sprayed", "glass", "steel"]

_OFF: dict[str, Any] = {"option": None}


class SimulationOptions(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """One data set. These options and a scene's seed determine every pixel of the scene."""

    sensor: str = "d415"
    """d415, d435, d455, azure_kinect or the path of a specification"""
    views: Views = 30
    """frames of a scene"""
    order: ViewOrder = "random"
    """viewpoints drawn independently, or along a smooth path as the curation pipeline needs them"""
    sweep_deg: Annotated[float, msgspec.Meta(ge=-3600, le=3600)] = 120.0
    """angle of a smooth path around the table, negative for clockwise"""
    width: Pixels = 640
    """of infrared, depth and labels, in pixels (a time-of-flight camera: its own size)"""
    height: Pixels = 360
    """of infrared, depth and labels, in pixels"""
    color_factor: Annotated[int, msgspec.Meta(ge=1, le=4)] = 1
    """the colour image is this many times as large"""
    min_objects: Annotated[Count, msgspec.Meta(extra=_OFF)] = 6
    """fewest objects of a scene, distractors among them"""
    max_objects: Annotated[Count, msgspec.Meta(extra=_OFF)] = 10
    """most objects of a scene"""
    assets: str = "procedural"
    """source of the objects: procedural, shapenet, folder or a plug-in"""
    assets_root: str | None = None
    """folder of the asset source's files"""
    scenes_from: str = DROP
    """drop: objects fall on the floor; graspnet: objects and their poses are those of the scenes
    of GraspNet-1Billion; or, with --twins, a folder of labelled scenes: toolkit scenes, BOP or
    GraspNet-1Billion"""
    object_poses: ObjectPoses = "mixed"
    """any: objects fall in any pose, as in DREDS; upright: they stand, if their shape lets them;
    mixed: in half of the scenes they stand"""
    graspnet_root: str | None = None
    """folder of GraspNet-1Billion: scenes/ and models/"""
    pattern: str | None = None
    """image that the projector shows (dots in the sensor's style)"""
    pattern_fov_deg: Annotated[float | None, msgspec.Meta(extra={"option": "pattern-fov"})] = None
    """width of the pattern as an angle in degrees (the projector's)"""
    environments: str | None = None
    """folder of .hdr and .exr environment maps (procedural ones)"""
    floors: str | None = None
    """folder of floor images (procedural textures)"""
    split: Annotated[Literal["train", "test", "all"], msgspec.Meta(extra=_OFF)] = "train"
    """which assets, maps and floors: train and test share none"""
    quality: QualityName = "draft"
    """light paths per pixel"""
    collision: Collision = "parts"
    """parts: objects collide as convex parts; coarse: those that fill at least 60 % of their convex
    hull collide as the hull, and the decomposition takes half of its time"""
    matcher: str = "local"
    """stereo matcher: local, sgbm, dreds or a plug-in"""
    materials: MaterialSwitch = "mixed"
    """mixed as in DREDS; clear: half of the objects, of any category, are transparent; fixed:
    objects keep their original texture; opaque: none is transparent"""
    fix: tuple[Factor, ...] = ()
    """what all scenes and views share, for ablations: objects (their shapes, sizes and poses; the
    letter O of the DREDS paper), materials (M), lighting (L), background (B), camera (C)"""
    infrared_noise: bool = True
    """the sensor's noise: shot and read noise in infrared, correlated noise of the disparity"""
    depth: DepthInput = "sensor"
    """sensor: stereo; cut: exact depth without transparent and specular objects; exact: of all,
    with black infrared images, in half of the time: colour for training, which takes depth away"""

    allow_code: bool = False
    """import what the file of --sensor names as file.py:NAME or package.module:NAME, which runs
    code"""

    def __post_init__(self) -> None:
        check_options(self)
        if self.min_objects > self.max_objects:
            raise ToolkitError(
                "must not exceed max_objects", field="min_objects", value=self.min_objects
            )
        if (self.scenes_from == GRASPNET) != (self.graspnet_root is not None):
            raise ToolkitError(
                "scenes of GraspNet-1Billion and the folder of that data set go together",
                field="graspnet_root",
                value=self.graspnet_root,
                hint="give --scenes-from graspnet and --graspnet-root DIR, or neither",
            )
        if self.pattern is None and self.pattern_fov_deg is not None:
            raise ToolkitError(
                "the angle of a pattern needs the pattern's image", field="pattern_fov_deg"
            )
        if len(set(self.fix)) < len(self.fix):
            raise ToolkitError("names something twice", field="fix", value=self.fix)
        if self.max_objects > 20:
            raise ToolkitError(
                "the DREDS layout supports at most 20 objects",
                field="max_objects",
                value=self.max_objects,
            )


@dataclass(frozen=True, kw_only=True)
class Preset:
    """Options and the number of scenes; command-line options override both."""

    scenes: int
    options: SimulationOptions


PRESETS: dict[PresetName, Preset] = {
    # The public data set: 30 views a scene, labels of 640x360 beside colour of 1280x720.
    "dreds": Preset(
        scenes=100,
        options=SimulationOptions(color_factor=2, quality="better", object_poses="any"),
    ),
    "draft": Preset(scenes=10, options=SimulationOptions()),
    # For tests and for trying a benchmark.
    "tiny": Preset(
        scenes=4, options=SimulationOptions(views=4, width=320, height=180, quality="rough")
    ),
}


@dataclass(frozen=True, kw_only=True)
class SceneOptions:
    """Scenes of a set; options that are not given are those of the preset."""

    preset: PresetName = "draft"
    """defaults of the options of a scene"""
    seed: Seed = 0
    """of the first scene; the others follow it"""
    options: SimulationOptions = field(default_factory=SimulationOptions)


@dataclass(frozen=True, kw_only=True)
class RunCommand(SceneOptions):
    """Simulate scenes.

    Scenes that are there already are kept: run the same command again to resume, or with more
    scenes to add some.
    """

    out: Path = field(metadata={"option": "out", "writes": Writes("results", ("simulation.json",))})
    """data set"""
    scenes: Annotated[int, msgspec.Meta(ge=0, le=100_000)] | None = None
    """number of scenes (that of the preset)"""
    share: Annotated[float, msgspec.Meta(gt=0, le=1)] = 1.0
    """make this share of the scenes only, spread evenly: an ablation of the amount of data"""
    split: Literal["train", "val", "test"] = "train"
    """part of the data set; validation scenes are made of the training shapes and light"""
    layout: tuple[Layout, ...] = field(default=(), metadata={"repeat": True})
    """dreds: DREDS-CatKnown; novel: DREDS-CatNovel; scene: toolkit scenes; several are possible"""
    cache: Path | None = field(default=None, metadata={"writes": Writes("parts")})
    """folder that keeps convex parts (~/.cache/std-toolkit)"""
    twins: tuple[TwinName, ...] = ()
    """render the labelled scenes of --scenes-from again with their own cameras and poses, once for
    each material; --views is then the most frames of a scene"""
    jobs: JobOptions = field(default_factory=JobOptions)

    def __post_init__(self) -> None:
        source = self.options.scenes_from
        named = source in (DROP, GRASPNET)
        if self.twins and named:
            raise ToolkitError(
                "twins are of a folder of labelled scenes",
                field="scenes_from",
                value=source,
                hint="give --scenes-from DIR: a toolkit scene, a BOP folder or GraspNet-1Billion",
            )
        if not self.twins and not named:
            raise ToolkitError(
                "a folder of labelled scenes is rendered again as twins",
                field="scenes_from",
                value=source,
                hint=f"add --twins {' '.join(get_args(TwinName))}, or give drop or graspnet",
            )
        if self.twins and set(self.layout) - {"scene"}:
            raise ToolkitError(
                "twins are toolkit scenes", field="layout", value=" ".join(self.layout),
                hint="leave --layout out",
            )  # fmt: skip


@dataclass(frozen=True, kw_only=True)
class PreviewCommand(SceneOptions):
    """Simulate views of one scene into a picture.

    It shows colour, infrared, raw depth, exact depth and error.
    """

    out: Path = field(metadata={"option": "out", "writes": Writes("file")})
    """picture"""

    def __post_init__(self) -> None:
        if self.options.scenes_from not in (DROP, GRASPNET):
            raise ToolkitError(
                "only `std-sim run --twins` renders labelled scenes again",
                field="scenes_from",
                value=self.options.scenes_from,
                hint="drop or graspnet",
            )


@dataclass(frozen=True, kw_only=True)
class StatsCommand:
    """Read a data set in the DREDS layout and print what it holds."""

    root: Path
    """data set"""
    csv: Path | None = field(default=None, metadata={"writes": Writes("file", suffix=".csv")})
    """write the depth table to this file"""
    json: bool = False
    """print JSON"""


@dataclass(frozen=True, kw_only=True)
class AssetsCommand:
    """List or download free (CC0) environment maps and floors. Nothing else downloads anything."""

    action: Literal["list", "fetch"]
    """list: print names, sizes and licences; fetch: download what is not there yet"""
    out: Path = field(default=Path("assets"), metadata={"option": "out", "writes": Writes("parts")})
    """folder, which gets sub-folders for --environments and --floors"""
    list_file: Path | None = None
    """another list of files with checksums"""


@dataclass(frozen=True, kw_only=True)
class TurntableOptions(CheckedOptions):
    """Photograph a mesh that stands on the printed board, path traced.

    Writes photos/, board.json and truth/ (cameras.json, mesh.ply, masks/) in the form that
    std-scan reads. The world is the frame of the board: z up, the table at z = 0, metres.
    """

    mesh: Path = field(metadata={"option": "mesh"})
    """mesh file in metres"""
    out: Path = field(metadata={"option": "out", "writes": Writes("results", ("turntable.json",))})
    """folder"""
    mesh_unit: Literal["m", "cm", "mm"] = "m"
    """unit of the mesh file"""
    up: Literal["x", "y", "z"] = "z"
    """axis of the mesh that points upwards"""
    flipped: bool = False
    """stand the object upside down, for the photos of its bottom"""
    material: TurntableMaterial = "own"
    """own: the mesh's texture; sprayed: diffuse grey, nearly without texture; glass: clear, with
    refraction; steel: polished"""
    motion: Literal["walk", "turntable"] = "walk"
    """the camera walks around the object, or the board turns before a camera at rest"""
    views: Annotated[int, msgspec.Meta(ge=2, le=1000)] = 48
    """number of photos, at two heights"""
    width: Annotated[int, msgspec.Meta(ge=64, le=8192)] = 1280
    """of the photos, in pixels"""
    height: Annotated[int, msgspec.Meta(ge=64, le=8192)] = 720
    """of the photos, in pixels"""
    fov_deg: Annotated[float, msgspec.Meta(gt=5, lt=120, extra={"option": "fov"})] = 60.0
    """horizontal field of view"""
    elevations_deg: tuple[Elevation, Elevation] = field(
        default=(22.0, 50.0), metadata={"option": "elevations"}
    )
    """heights of the camera, as angles above the table"""
    paper: Literal["a4", "a3", "letter"] = "a4"
    """size of the printed board"""
    environment: Path | None = None
    """lat-long .hdr or .exr map (a procedural room with area lights)"""
    samples: Annotated[int, msgspec.Meta(ge=1, le=4096)] = 12
    """light paths per pixel, before the denoiser"""
    aperture_mm: Annotated[float, msgspec.Meta(ge=0, le=50)] = 2.5
    """diameter of the lens opening, for defocus; 0: everything is sharp"""
    noise: Annotated[float, msgspec.Meta(ge=0, le=20)] = 1.0
    """noise of the camera, 1 as in good light"""
    seed: Seed = 0
    """of light, hand and noise"""


def with_preset(words: list[str]) -> list[str]:
    """The options of the requested preset, followed by the given ones.

    Several layouts may follow one `--layout`. A camera that is no stereo camera has images of its
    own size, unless a preset or a size is given.
    """
    words = _one_layout_each(words)
    start = next((i for i, w in enumerate(words) if w not in ("--quiet", "--debug")), len(words))
    command = "".join(words[start : start + 1])
    start += command in ("run", "preview")
    added = ["--views", "4"] if command == "preview" else []
    given = [word.partition("=")[2] for word in words if word.startswith("--preset=")]
    given += [words[i + 1] for i, word in enumerate(words[:-1]) if word == "--preset"]
    if given:
        chosen = next((p.options for name, p in PRESETS.items() if name == given[-1]), None)
        added = [*(words_of(SceneOptions(options=chosen)) if chosen else []), *added]
    elif command not in ("turntable", "assets", "stats"):
        added = [*_own_size(words), *added]
    return [*words[:start], *added, *words[start:]]


def _own_size(words: list[str]) -> list[str]:
    """Width and height of a sensor that has no depth at sizes of the user's choice."""
    if any(word.partition("=")[0] in ("--width", "--height") for word in words):
        return []
    named = [word.partition("=")[2] for word in words if word.startswith("--sensor=")]
    named += [words[i + 1] for i, word in enumerate(words[:-1]) if word == "--sensor"]
    if not named:
        return []
    from sensors.specs.sensor import load_sensor  # not needed for the help page

    try:
        sensor = load_sensor(named[-1])
    except ToolkitError:  # told when the options are read
        return []
    if sensor.depth_model == "stereo":
        return []
    own = min(sensor.color, key=lambda camera: camera.width)
    return ["--width", str(own.width), "--height", str(own.height)]


def _one_layout_each(words: list[str]) -> list[str]:
    found: list[str] = []
    after_layout = False
    for word in words:
        if after_layout and not word.startswith("-") and found[-1] != "--layout":
            found.append("--layout")
        after_layout = word == "--layout" or (after_layout and not word.startswith("-"))
        found.append(word)
    return found
