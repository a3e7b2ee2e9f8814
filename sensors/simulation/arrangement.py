"""Category-agnostic scenes: real objects that lie as in a scene of GraspNet-1Billion.

A data set's seed picks the scene; materials, floor, light and viewpoints are drawn from it as for
dropped objects. As in that data set, scenes 0 to 99 are for training and the others for testing.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from sensors.assets import Asset
from sensors.physics import GraspNetScenes
from sensors.simulation.options import SimulationOptions
from std_toolkit.errors import ToolkitError
from std_toolkit.geometry.se3 import SE3

# Any of its objects may be made of anything, as vessels are.
DRESSED_AS = "bottle"
FIRST_TEST_SCENE = 100


@dataclass(frozen=True, eq=False)
class Arrangement:
    """Objects at rest.

    Attributes:
        scene: number of the scene in GraspNet-1Billion.
        assets: its objects.
        poses: T_world_obj of each, their middle above the origin, the floor at z = 0.
    """

    scene: int
    assets: list[Asset]
    poses: tuple[SE3, ...]


class Arrangements:
    """The scenes of a GraspNet-1Billion folder that belong to a split.

    Args:
        options: `graspnet_root` and `split` are heeded.

    Raises:
        ToolkitError: not such a folder, or no scene of the split in it.
    """

    def __init__(self, options: SimulationOptions) -> None:
        assert options.graspnet_root is not None
        root = Path(options.graspnet_root)
        self._scenes = GraspNetScenes(root)
        self._numbers = [
            n
            for n in self._scenes.scenes()
            if options.split == "all" or (n >= FIRST_TEST_SCENE) == (options.split == "test")
        ]
        if not self._numbers:
            raise ToolkitError(
                f"no annotated scene of the split {options.split!r} here",
                path=root / "scenes",
                hint="training scenes are scene_0000 to scene_0099, the others are for testing",
            )

    def of_seed(self, seed: int, *, cache: Path | None = None) -> Arrangement:
        """The scene of a seed; further seeds go through all of them again and again.

        Args:
            seed: of the simulated scene.
            cache: folder of convex parts.

        Raises:
            ToolkitError: see `GraspNetScenes.arrangement`.
        """
        number = self._numbers[seed % len(self._numbers)]
        objects, poses = self._scenes.arrangement(number, cache=cache)
        # Viewpoints look at the origin; the annotated table's lies where its marker was.
        middle = np.mean([T.t for T in poses], axis=0) * [1.0, 1.0, 0.0]
        return Arrangement(
            number, [o.asset for o in objects], tuple(SE3(T.R, T.t - middle) for T in poses)
        )
