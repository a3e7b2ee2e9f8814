"""Interface of the simulator's renderers: light arriving at cameras, in floating point.

`infrared_image` and `color_image` turn the light into images (exposure, noise, 8 bits); `truth`
renders the exact maps. Neither depends on which renderer is used.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

from sensors.lighting.environment import EnvironmentMap
from sensors.render.sim_scene import Projector, SceneObject, SimScene
from std_toolkit.arrays import Floats
from std_toolkit.errors import ToolkitError
from std_toolkit.geometry import SE3, Camera
from std_toolkit.plugins import Registry


@dataclass(frozen=True, kw_only=True)
class RenderOptions:
    """Quality of one image.

    Attributes:
        samples: paths per pixel; with `ambient_samples`, those of the projector's light that no
            diffuse surface scattered.
        ambient_samples: paths per pixel of a separate image of all other light, which is denoised
            (infrared only). It has no dots for the denoiser to alter. 0 renders all light
            together, with noise.
        fast_denoiser: use the smaller network of the denoiser: half the time, 0.5 to 1 dB lost.
        chunk: number of paths averaged into one estimate of a pixel; estimates far above the median
            of the pixel's are clipped, against fireflies. 0 disables the clipping.
        max_depth: longest path in surfaces.
        diffuse_bounces: a path ends at its n-th diffuse surface (mirrors and glass do not count):
            light scattered more often has lost the pattern and most of its strength.
        roulette_depth: depth from which dark paths end at random.
        projector_weight: at indirectly visible surfaces, number of samples of the projector's light
            per sample of the environment's. Directly visible surfaces sample both.

    Raises:
        ToolkitError: a value out of range, or chunks that do not divide the samples.
    """

    samples: int = 32
    ambient_samples: int = 0
    fast_denoiser: bool = False
    chunk: int = 8
    max_depth: int = 8
    diffuse_bounces: int = 2
    roulette_depth: int = 3
    projector_weight: float = 2.0

    def __post_init__(self) -> None:
        for name, low in (
            ("samples", 1),
            ("ambient_samples", 0),
            ("chunk", 0),
            ("max_depth", 1),
            ("diffuse_bounces", 1),
            ("roulette_depth", 1),
        ):
            if getattr(self, name) < low:
                raise ToolkitError(f"must be at least {low}", field=name, value=getattr(self, name))
        if self.chunk and self.samples % self.chunk:
            raise ToolkitError(
                "must be a multiple of the chunk", field="samples", value=self.samples
            )


# The direct light of the dots is exact at any number of paths.
DRAFT_INFRARED = RenderOptions(samples=4, chunk=1, ambient_samples=2, fast_denoiser=True)
FINE_INFRARED = RenderOptions(samples=64, chunk=1, ambient_samples=16)
# Denoised, 8 paths are 41.0 and 45.9 dB in two views, 16 paths 42.5 and 47.3 dB, relative to 128
# paths; the camera's own noise is at 40 to 45 dB.
DRAFT_COLOR = RenderOptions(samples=8, chunk=0, fast_denoiser=True)


@dataclass(frozen=True, kw_only=True)
class Quality:
    """Render options of the two kinds of images."""

    infrared: RenderOptions
    color: RenderOptions


QUALITIES = {
    "rough": Quality(
        infrared=RenderOptions(samples=4, chunk=1, ambient_samples=1, fast_denoiser=True),
        color=RenderOptions(samples=6, chunk=0, fast_denoiser=True),
    ),
    "draft": Quality(infrared=DRAFT_INFRARED, color=DRAFT_COLOR),
    "better": Quality(
        infrared=RenderOptions(samples=16, chunk=1, ambient_samples=8),
        color=RenderOptions(samples=64, chunk=0),
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


@dataclass(frozen=True, eq=False)
class ColorLight:
    """Colour as rendered, with the auxiliary images of a denoiser.

    Attributes:
        radiance: (H, W, 3) float32 linear RGB.
        albedo: (H, W, 3) float32 reflectance of the first surface, or None.
        normal: (H, W, 3) float32 normal of the first surface, world frame, or None.
    """

    radiance: Floats
    albedo: Floats | None = None
    normal: Floats | None = None


@runtime_checkable
class LoadedScene(Protocol):
    """A loaded scene, ready to be rendered from any number of views."""

    def change(self, environment: EnvironmentMap, rotation_rad: float, floor: SceneObject) -> None:
        """Change the light and the material of the scene's first object, its floor.

        Args:
            environment: environment light of the following views.
            rotation_rad: of it about the world's z axis.
            floor: the first object with its new material; its mesh stays.
        """
        ...

    def infrared_pair(
        self,
        camera: Camera,
        T_world_cams: tuple[SE3, SE3],
        projector: Projector | None,
        *,
        ambient: float,
        options: RenderOptions = DRAFT_INFRARED,
        seed: int = 0,
    ) -> tuple[Floats, Floats]:
        """`infrared` of two cameras, with different paths: equal noise would match as texture."""
        ...

    def infrared(
        self,
        camera: Camera,
        T_world_cam: SE3,
        projector: Projector | None,
        *,
        ambient: float,
        options: RenderOptions = DRAFT_INFRARED,
        seed: int = 0,
    ) -> Floats:
        """(H, W) float32 radiance under the projector and `ambient` times the environment.

        What the projector lights is never denoised: a denoiser would add dots, which stereo then
        matches.
        """
        ...

    def color(
        self,
        camera: Camera,
        T_world_cam: SE3,
        *,
        ambient: float,
        options: RenderOptions = DRAFT_COLOR,
        seed: int = 0,
    ) -> ColorLight:
        """Colour under `ambient` times the environment, the projector off; noise included."""
        ...


@runtime_checkable
class SimRenderer(Protocol):
    """A renderer. Register one under the entry-point group `std_toolkit.sim_renderers`.

    Attributes:
        name: identifier in records, the variant included (`mitsuba/llvm_ad_rgb`).
    """

    name: str

    def load(self, scene: SimScene) -> LoadedScene:
        """Prepare a scene. The same scene, view, options and seed give the same image."""
        ...


# A plug-in is called with the number of threads it may use, None for all cores.
SIM_RENDERERS: Registry[Callable[..., SimRenderer]] = Registry(
    "std_toolkit.sim_renderers",
    {"mitsuba": "sensors.render.mitsuba_renderer:MitsubaRenderer"},
)
