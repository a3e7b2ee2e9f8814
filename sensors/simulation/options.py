"""Options of a simulated set, the named presets, and the qualities (light paths per image).

Named sets of options.

How many light paths an image gets.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Literal

import msgspec

from sensors.materials import MATERIAL_CLASSES, MaterialClass
from sensors.render.sim_renderer import (
    DRAFT_COLOR,
    DRAFT_INFRARED,
    FINE_INFRARED,
    RenderOptions,
)
from std_toolkit.errors import ToolkitError

Count = Annotated[int, msgspec.Meta(ge=1)]

ViewOrder = Literal["random", "arc", "spiral"]

DepthInput = Literal["sensor", "cut"]

MaterialSwitch = Literal["mixed", "fixed", "opaque"]

SceneOrigin = Literal["drop", "graspnet"]


class SimulationOptions(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """One data set. Together with a scene's seed these numbers decide every pixel of it.

    Attributes:
        sensor: built-in specification ("d415", ...) or path of one.
        views: frames of a scene.
        order: viewpoints drawn independently, or along a smooth way ("arc", "spiral"), as the
            curation pipeline needs them.
        sweep_deg: angle of a smooth way around the table, negative for clockwise.
        width, height: of the infrared images, the depth and the labels.
        color_factor: the colour image is so many times as large.
        min_objects, max_objects: objects of a scene, distractors among them.
        assets, assets_root: asset source and the folder of its files.
        scenes_from: "drop": objects of the asset source fall on the floor; "graspnet": objects and
            where they lie are those of the scenes of GraspNet-1Billion.
        graspnet_root: its folder.
        pattern, pattern_fov_deg: image that the projector throws instead of one made in the
            sensor's style, and the angle between its left and right edges; None: the projector's.
        environments: folder of environment maps; None for the procedural ones.
        floors: folder of floor images; None for procedural textures.
        split: which assets, maps and floors: "train" and "test" share none.
        quality: samples per pixel, one of `sensors.simulation.options`.
        matcher: stereo matcher, see `sensors.stereo`.
        materials: "mixed" as in DREDS; "fixed": objects keep their own look, class raw; "opaque":
            no transparent ones.
        infrared_noise: shot and read noise in the infrared images.
        depth: "sensor", or "cut": exact depth from which transparent and specular objects are
            cut out, the input that needs no sensor simulation.
    """

    sensor: str = "d415"
    views: Count = 30
    order: ViewOrder = "random"
    sweep_deg: float = 120.0
    width: Count = 640
    height: Count = 360
    color_factor: Annotated[int, msgspec.Meta(ge=1, le=4)] = 1
    min_objects: Count = 6
    max_objects: Count = 10
    assets: str = "procedural"
    assets_root: str | None = None
    scenes_from: SceneOrigin = "drop"
    graspnet_root: str | None = None
    pattern: str | None = None
    pattern_fov_deg: float | None = None
    environments: str | None = None
    floors: str | None = None
    split: Literal["train", "test", "all"] = "train"
    quality: str = "draft"
    matcher: str = "local"
    materials: MaterialSwitch = "mixed"
    infrared_noise: bool = True
    depth: DepthInput = "sensor"

    def __post_init__(self) -> None:
        for name in ("views", "width", "height", "color_factor", "min_objects"):
            if getattr(self, name) < 1:
                raise ToolkitError("must be at least 1", field=name, value=getattr(self, name))
        if self.min_objects > self.max_objects:
            raise ToolkitError(
                "must not exceed max_objects", field="min_objects", value=self.min_objects
            )
        if (self.scenes_from == "graspnet") != (self.graspnet_root is not None):
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
        if self.max_objects > 20:
            raise ToolkitError(
                "the DREDS layout tells at most 20 objects apart",
                field="max_objects",
                value=self.max_objects,
            )

    @property
    def material_classes(self) -> tuple[MaterialClass, ...]:
        """The classes that `materials` leaves."""
        if self.materials == "fixed":
            return ("raw",)
        if self.materials == "opaque":
            return tuple(c for c in MATERIAL_CLASSES if c != "transparent")
        return MATERIAL_CLASSES


@dataclass(frozen=True, kw_only=True)
class Preset:
    """Options and the number of scenes; what the command line tells comes before either."""

    scenes: int
    options: SimulationOptions


PRESETS = {
    # The public data set: 30 views a scene, labels of 640x360 beside colour of 1280x720.
    "dreds": Preset(scenes=100, options=SimulationOptions(color_factor=2, quality="better")),
    "draft": Preset(scenes=10, options=SimulationOptions()),
    # For tests and for trying a benchmark.
    "tiny": Preset(
        scenes=4, options=SimulationOptions(views=4, width=320, height=180, quality="rough")
    ),
}


def preset(name: str) -> Preset:
    """The preset called `name`.

    Raises:
        ToolkitError: there is none.
    """
    if name not in PRESETS:
        raise ToolkitError(
            "unknown preset", field="preset", value=name, hint=f"one of {', '.join(PRESETS)}"
        )
    return PRESETS[name]


@dataclass(frozen=True, kw_only=True)
class Quality:
    """Of the two kinds of images."""

    infrared: RenderOptions
    color: RenderOptions


QUALITIES = {
    "rough": Quality(
        infrared=RenderOptions(samples=8, chunk=2), color=RenderOptions(samples=12, chunk=0)
    ),
    "draft": Quality(infrared=DRAFT_INFRARED, color=DRAFT_COLOR),
    "better": Quality(
        infrared=RenderOptions(samples=32, chunk=8), color=RenderOptions(samples=64, chunk=0)
    ),
    "fine": Quality(infrared=FINE_INFRARED, color=RenderOptions(samples=256, chunk=0)),
}


def quality_of(name: str) -> Quality:
    """The quality called `name`.

    Raises:
        ToolkitError: there is none.
    """
    if name not in QUALITIES:
        raise ToolkitError(
            "unknown quality", field="quality", value=name, hint=f"one of {', '.join(QUALITIES)}"
        )
    return QUALITIES[name]
