"""The interface of depth models, and their registry."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from sensors.render.sim_renderer import LoadedScene, RenderOptions
from sensors.specs import SensorSpec
from std_toolkit.geometry import SE3, Camera
from std_toolkit.plugins import Registry


@dataclass(frozen=True, kw_only=True)
class DepthModelOptions:
    """Options of a data set that concern the depth model.

    Attributes:
        width, height: of the colour image in pixels; see `SensorSpec.depth_camera`.
        matcher: name of the stereo matcher.
        pattern: image that the projector shows; None: dots in the sensor's style.
        pattern_fov_deg: its width as an angle; None: the projector's.
        noise: whether the camera has noise.
        threads: that the model may use; None uses all cores.
    """

    width: int
    height: int
    matcher: str = "local"
    pattern: Path | None = None
    pattern_fov_deg: float | None = None
    noise: bool = True
    threads: int | None = None


@dataclass(frozen=True, kw_only=True)
class Illumination:
    """Light of one view in infrared.

    Attributes:
        ambient: strength of the environment's light.
        factor: strength of the camera's own light, 1 as specified.
        pattern_seed: of the projected pattern, which the views of a scene share.
    """

    ambient: float
    factor: float
    pattern_seed: int


@dataclass(frozen=True, eq=False)
class Reading:
    """What the camera puts out for one view.

    Attributes:
        depth: (h, w) float32 z-depth in metres in the (left) infrared camera, 0 = no measurement.
        left: (h, w) uint8 infrared image.
        right: (h, w) uint8 image of the second infrared camera; None if there is one camera.
    """

    depth: NDArray[np.float32]
    left: NDArray[np.uint8]
    right: NDArray[np.uint8] | None = None


class DepthModel(Protocol):
    """A principle of measurement, for example stereo matching.

    Attributes:
        camera: intrinsics of depth and infrared images.
    """

    camera: Camera

    def look(
        self,
        loaded: LoadedScene,
        T_world_ir: SE3,
        light: Illumination,
        *,
        options: RenderOptions,
        seed: int,
    ) -> Any:
        """Render the light that reaches the camera: the only step that uses the renderer."""
        ...

    def read(self, received: Any, *, seed: int) -> Reading:
        """Images and depth from the result of `look`. It may run in another thread.

        Args:
            received: from `look`.
            seed: of the camera's noise.
        """
        ...


# A plug-in is called with the sensor and the options.
DEPTH_MODELS: Registry[Callable[[SensorSpec, DepthModelOptions], DepthModel]] = Registry(
    "std_toolkit.depth_models",
    {
        "stereo": "sensors.depth_models.stereo:ActiveStereo",
        "time_of_flight": "sensors.depth_models.time_of_flight:TimeOfFlight",
    },
)


def make_depth_model(sensor: SensorSpec, options: DepthModelOptions) -> DepthModel:
    """The depth model that a sensor names.

    Args:
        sensor: its `depth_model` is a name of the registry, or `package.module:attribute`.
        options: of the data set.

    Raises:
        ToolkitError: no such model, or one that cannot use these options.
    """
    return DEPTH_MODELS.get(sensor.depth_model)(sensor, options)
