"""A depth camera as data: its fields, the JSON files, and their generated JSON Schema.

Sensors are loaded by name, or from your own file.
"""

from pathlib import Path
from typing import Annotated, Literal

import msgspec
import numpy as np

from std_toolkit.errors import ToolkitError
from std_toolkit.geometry import SE3, Camera
from std_toolkit.io.documents import DIALECT, InvalidDocument, read_document
from std_toolkit.scene import document
from std_toolkit.scene.pose_model import CameraModel

Angles = Annotated[list[Annotated[float, msgspec.Meta(gt=1, lt=170)]],
                   msgspec.Meta(min_length=2, max_length=2)]  # fmt: skip

Range = Annotated[list[Annotated[float, msgspec.Meta(ge=0, le=1000)]],
                  msgspec.Meta(min_length=2, max_length=2)]  # fmt: skip

# A 16-bit image at the finest unit covers 6.5 cm.
Unit = Annotated[float, msgspec.Meta(ge=1e-6, le=0.1)]

# Two sizes are scaled copies of one image if their aspect ratios differ by less: 848x480 is
# nominally 16:9.
SAME_ASPECT = 0.01

FOLDER = Path(__file__).parent

SCHEMA = FOLDER / "sensor.schema.json"


class Source(document.Document, frozen=True, kw_only=True):
    """Origin of figures.

    Attributes:
        text: the document or measurement.
        estimate: not measured or published; the text gives the basis of the estimate.
    """

    text: str
    estimate: bool = False


class ProjectorSpec(document.Document, frozen=True, kw_only=True):
    """The infrared projector of dots.

    Attributes:
        position_m: in the frame of the left infrared camera. It looks along that camera's axis.
        fov_deg: full angles, across and down, of the pattern.
        style: arrangement of the dots; see `sensors.pattern`.
        dots_in_view: number of dots inside the depth field of view.
        lit_share: fraction of the pattern that is brighter than half of a dot's peak.
        roll_deg: rotation of the pattern about its axis.
    """

    position_m: document.Vector3
    fov_deg: Angles
    style: Literal["two_lattices", "scattered"]
    dots_in_view: Annotated[int, msgspec.Meta(ge=100, le=1_000_000)]
    lit_share: Annotated[float, msgspec.Meta(gt=0, lt=0.5)]
    roll_deg: float = 0.0

    @property
    def T_ir_projector(self) -> SE3:
        angle = np.deg2rad(self.roll_deg) / 2
        return SE3.from_quat([np.cos(angle), 0, 0, np.sin(angle)], self.position_m)


class TimeOfFlightSpec(document.Document, frozen=True, kw_only=True):
    """A camera that measures the phase of modulated light (amplitude-modulated continuous wave).

    Amplitudes are relative to that of a white diffuse surface that faces the camera at 1 m.

    Attributes:
        frequencies_hz: modulation frequencies; together they determine the distance.
        illuminator_m: position of the light in the frame of the infrared camera. It looks along
            that camera's axis.
        illumination_deg: full angles, across and down, that the light covers.
        least_amplitude: a pixel with a smaller mean amplitude has no depth.
        most_phase_error_rad: a pixel whose phases fit no common distance better than this has no
            depth: light of several path lengths.
        read_noise: standard deviation of a measured amplitude without light.
        shot_noise: standard deviation that light of amplitude 1 adds.
    """

    frequencies_hz: Annotated[list[Annotated[float, msgspec.Meta(gt=1e6, lt=1e9)]],
                              msgspec.Meta(min_length=1, max_length=8)]  # fmt: skip
    illuminator_m: document.Vector3
    illumination_deg: Angles
    least_amplitude: document.Positive
    most_phase_error_rad: document.Positive
    read_noise: document.NonNegative
    shot_noise: document.NonNegative


class DepthSpec(document.Document, frozen=True, kw_only=True):
    """Properties of the depth stream.

    Attributes:
        field_of_view_deg: full angles, across and down.
        unit_m: metres per unit of the 16-bit depth image.
        range_m: nearest and farthest depth that is reported.
        disparities: number of disparities that a stereo camera searches, at any image size.
        noise_px: standard deviation of a stereo camera's disparity on a well textured surface.
    """

    field_of_view_deg: Angles
    unit_m: Unit
    range_m: Range
    disparities: Annotated[int, msgspec.Meta(ge=16, le=512)] | None = None
    noise_px: document.NonNegative = 0.0

    def check(self) -> None:
        if not self.range_m[0] < self.range_m[1]:
            raise ToolkitError("near must be less than far", field="range_m", value=self.range_m)


class SensorSpec(document.Document, frozen=True, kw_only=True):
    """A depth camera: active stereo, time of flight, or a plug-in's principle.

    Attributes:
        name: short name, as on the command line.
        title: full name.
        depth_model: name of the model that computes its depth, `stereo` or `time_of_flight`; see
            `sensors.depth_models`.
        infrared: intrinsics of the infrared cameras (they are rectified) per image size.
        color: intrinsics of the colour camera per image size.
        baseline_m: from the left infrared camera to the right one, along x; 0 with one camera.
        T_ir_color: pose of the colour camera in the left infrared one, whose frame is depth's.
        projector: of dots, or null for a passive camera.
        time_of_flight: modulation, light and noise of a time-of-flight camera, or null.
        depth: range, unit and noise.
        sources: field (`infrared`, `depth.noise_px`, ...) to the origin of its figures. A field
            includes those below it.
    """

    name: str
    title: str
    infrared: Annotated[list[CameraModel], msgspec.Meta(min_length=1)]
    color: Annotated[list[CameraModel], msgspec.Meta(min_length=1)]
    T_ir_color: document.Pose16
    depth: DepthSpec
    depth_model: str = "stereo"
    baseline_m: Annotated[float, msgspec.Meta(ge=0, lt=1)] = 0.0
    projector: ProjectorSpec | None = None
    time_of_flight: TimeOfFlightSpec | None = None
    sources: dict[str, Source] = msgspec.field(default_factory=dict)

    def check(self) -> None:
        document.check_pose(self.T_ir_color, "T_ir_color")
        for stream in ("infrared", "color"):
            sizes = [(c.width, c.height) for c in getattr(self, stream)]
            if len(set(sizes)) < len(sizes):
                raise InvalidDocument("an image size appears twice", field=stream, value=sizes)
        for camera in self.infrared:
            if any(camera.distortion):
                raise InvalidDocument(
                    "infrared images are rectified: no distortion",
                    field="infrared",
                    value=camera.distortion,
                )
        if self.depth_model == "stereo":
            for name, value in (
                ("baseline_m", self.baseline_m),
                ("depth.disparities", self.depth.disparities),
            ):
                if not value:
                    raise InvalidDocument("a stereo camera needs it", field=name, value=value)
        if self.depth_model == "time_of_flight" and self.time_of_flight is None:
            raise InvalidDocument(
                "a time-of-flight camera needs it", field="time_of_flight", value=None
            )
        known = figures(self)
        for field in self.sources:
            if field not in known:
                raise InvalidDocument(
                    "a source for a field that does not exist",
                    field="sources",
                    value=field,
                    hint=f"known: {', '.join(known)}",
                )

    def depth_camera(self, width: int, height: int) -> Camera:
        """The infrared camera for colour images of this size.

        It has that size where the aspect ratio exists, as in stereo cameras. Otherwise it is the
        smallest listed one that is not narrower, or the widest.
        """
        if _of_aspect(self.infrared, width, height):
            return self.infrared_camera(width, height)
        wide = [m for m in self.infrared if m.width >= width]
        chosen = (
            min(wide, key=lambda m: m.width) if wide else max(self.infrared, key=lambda m: m.width)
        )
        return chosen.camera()

    def infrared_camera(self, width: int, height: int) -> Camera:
        """Both infrared cameras, and the depth image, at this size; see `camera_of_size`."""
        return camera_of_size(self.infrared, width, height, f"{self.name}: infrared")

    def has_proportions(self, width: int, height: int) -> bool:
        """Whether infrared images have the aspect ratio of width x height."""
        return bool(_of_aspect(self.infrared, width, height))

    def color_camera(self, width: int, height: int) -> Camera:
        """The colour camera at this size; see `camera_of_size`."""
        return camera_of_size(self.color, width, height, f"{self.name}: color")

    @property
    def pose_of_color(self) -> SE3:
        """`T_ir_color` as a pose."""
        return document.pose_from_list(self.T_ir_color)

    def disparity_range(self, width: int, height: int) -> tuple[int, int]:
        """Least and largest whole disparity that `depth.range_m` gives at this image size.

        The largest is also bounded by the number of disparities that the camera searches, which
        determines its nearest depth at large sizes.

        Raises:
            ToolkitError: not a stereo camera.
        """
        if self.depth.disparities is None or not self.baseline_m:
            raise ToolkitError(
                "not a stereo camera", field="depth_model", value=f"{self.name}: {self.depth_model}"
            )
        fb = self.infrared_camera(width, height).fx * self.baseline_m
        near, far = self.depth.range_m
        # The ends of a matcher's range are never winners: add one on each side.
        low = max(0, int(np.floor(fb / far)) - 1)
        wanted = int(np.ceil(fb / near)) + 1 if near > 0 else low + self.depth.disparities
        return low, min(wanted, low + self.depth.disparities - 1)


def camera_of_size(models: list[CameraModel], width: int, height: int, field: str) -> Camera:
    """The camera of an image of this size.

    A listed size is used unchanged, because a real camera's firmware crops and rounds in its own
    way. Any other is scaled from the largest of the same aspect ratio: edges of the image map to
    edges, and pixel centres are at integers.

    Raises:
        ToolkitError: no image of this aspect ratio is listed.
    """
    for model in models:
        if (model.width, model.height) == (width, height):
            return model.camera()
    alike = _of_aspect(models, width, height)
    if not alike:
        raise ToolkitError(
            "no image of this shape",
            field=field,
            value=f"{width}x{height}",
            hint=f"known: {', '.join(f'{m.width}x{m.height}' for m in models)}, "
            "or any other size of the same aspect ratio",
        )
    return max(alike, key=lambda m: m.width).camera().resized(width, height)


def _of_aspect(models: list[CameraModel], width: int, height: int) -> list[CameraModel]:
    return [m for m in models if abs(m.width * height / (m.height * width) - 1) < SAME_ASPECT]


def figures(spec: SensorSpec) -> list[str]:
    """Names of all fields with figures, as keys of `sources`."""
    stereo = ["baseline_m"] if spec.baseline_m else []
    names = ["infrared", "color", *stereo, "T_ir_color", "depth"]
    only_stereo = () if spec.depth.disparities else ("disparities", "noise_px")
    names += [f"depth.{f}" for f in DepthSpec.__struct_fields__ if f not in only_stereo]
    for part in ("projector", "time_of_flight"):
        if (value := getattr(spec, part)) is not None:
            names += [part, *(f"{part}.{field}" for field in value.__struct_fields__)]
    return names


def names() -> list[str]:
    """Names of the sensors that ship with the package."""
    return sorted(path.stem for path in FOLDER.glob("*.json") if path != SCHEMA)


def load_sensor(name: str | Path) -> SensorSpec:
    """The sensor called `name`, or the one that a JSON file describes.

    Args:
        name: a built-in name, in any case; or a path, recognised by its suffix or a separator.

    Raises:
        ToolkitError: no such sensor, or an invalid file: the message names the field.
    """
    path = Path(name)
    if path.suffix.lower() == ".json" or len(path.parts) > 1:
        return read_document(path, SensorSpec)
    if str(name).lower() not in names():
        raise ToolkitError(
            "no such sensor",
            field="sensor",
            value=str(name),
            hint=f"known: {', '.join(names())}; or give the path of a .json file",
        )
    return read_document(FOLDER / f"{str(name).lower()}.json", SensorSpec)


def schema_bytes() -> bytes:
    """The schema as it is stored beside the sensors, in `sensor.schema.json`."""
    schema = {
        "$schema": DIALECT,
        "$id": "https://std-toolkit.example/schemas/sensor.schema.json",
        **msgspec.json.schema(SensorSpec),
    }
    return msgspec.json.format(msgspec.json.encode(schema), indent=2) + b"\n"
