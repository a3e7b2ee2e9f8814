"""The smallest scene with every feature: a Mitsuba variant must render it to be chosen."""

import numpy as np

from sensors.lighting.environment_sources import studio_map
from sensors.materials.material_draw import draw_material
from sensors.materials.material_library import MaterialClass
from sensors.render.sim_renderer import RenderOptions
from sensors.render.sim_scene import Projector, SceneObject, SimScene, SurfaceMesh
from sensors.render.variant import DONE
from std_toolkit.geometry import SE3, Camera


def smallest_scene() -> SimScene:
    """A floor with a pyramid each of metal, glass and wood; cameras look down at it."""
    rng = np.random.default_rng(0)
    corners = np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]], float)
    floor = SurfaceMesh(2 * corners, np.array([[0, 1, 2], [0, 2, 3]]))
    pyramid = SurfaceMesh(
        np.concatenate([0.08 * corners, [[0, 0, 0.1]]]),
        np.array([[0, 1, 4], [1, 2, 4], [2, 3, 4], [3, 0, 4], [0, 2, 1], [0, 3, 2]]),
    )
    classes: tuple[MaterialClass, ...] = ("specular", "transparent", "diffuse")
    objects = [SceneObject(0, floor, SE3.identity(), draw_material(rng, "raw"))]
    for i, name in enumerate(classes):
        T = SE3(np.eye(3), np.array([0.2 * (i - 1), 0.0, 0.01]))
        objects.append(SceneObject(i + 1, pyramid, T, draw_material(rng, name)))
    return SimScene(tuple(objects), studio_map(0, height=16))


def looking_down(height_m: float = 0.8) -> SE3:
    """T_world_cam of a camera above the origin that looks straight down."""
    return SE3(np.diag([1.0, -1.0, -1.0]), np.array([0.0, 0.0, height_m]))


def limit_time(seconds: int) -> None:
    """End this process after a processor time, where the system can."""
    try:
        import resource
    except ImportError:  # Windows
        return
    _, most = resource.getrlimit(resource.RLIMIT_CPU)
    hard = seconds + 5 if most == resource.RLIM_INFINITY else min(most, seconds + 5)
    resource.setrlimit(resource.RLIMIT_CPU, (min(seconds, hard), hard))


def render_smallest(variant: str) -> None:
    """Render infrared and colour with a variant and print `DONE`.

    Raises:
        RuntimeError: the images are black or not finite.
    """
    from sensors.render.mitsuba_renderer import MitsubaRenderer

    loaded = MitsubaRenderer(variant=variant, check=False).load(smallest_scene())
    camera = Camera(8, 8, 8.0, 8.0, 3.5, 3.5)
    options = RenderOptions(samples=4, chunk=2)
    T = looking_down()
    projector = Projector(np.ones((8, 8), np.float32), 90.0, T, power=1.0)
    infrared = loaded.infrared(camera, T, projector, ambient=0.1, options=options)
    color = loaded.color(camera, T, ambient=1.0, options=RenderOptions(samples=4, chunk=0))
    for image in (infrared, color.radiance):
        if not np.isfinite(image).all() or image.mean() <= 0:
            raise RuntimeError(f"rendered light of mean {image.mean()}")
    print(DONE)
