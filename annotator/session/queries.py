"""What can be asked about an annotated scene, of a session and of a snapshot alike."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from annotator.session.cameras import Cameras
from annotator.session.meshes import MeshLibrary
from annotator.session.state import AnnotationState, ObjectState
from std_toolkit.geometry import SE3

if TYPE_CHECKING:
    import trimesh


class Queries:
    """Base of `Session` and `Snapshot`, which provide the state, the cameras and the meshes."""

    @property
    def state(self) -> AnnotationState:
        """Everything that was annotated; immutable."""
        raise NotImplementedError

    @property
    def cameras(self) -> Cameras:
        """Camera poses in metres; immutable."""
        raise NotImplementedError

    @property
    def meshes(self) -> MeshLibrary:
        """The meshes, read once."""
        raise NotImplementedError

    @property
    def posed(self) -> bool:
        """The camera poses are known in metres: one pose of an object holds in all frames."""
        return self.cameras.posed

    @property
    def pose_problem(self) -> str | None:
        """Why poses of objects cannot be carried from frame to frame; None if they can."""
        return self.cameras.problem

    @property
    def frames(self) -> tuple[int, ...]:
        """Ids of the frames in which a pose can be set, in recording order."""
        return self.cameras.frames

    def T_world_cam(self, frame: int) -> SE3 | None:
        """Camera pose in metres; None if there is none."""
        return self.cameras.T_world_cam(frame)

    def object(self, name: str) -> ObjectState:
        """Raises ToolkitError if there is none of this name."""
        return self.state.object(name)

    def pose(self, name: str, frame: int) -> SE3 | None:
        """T_cam_obj of an object in a frame; None where it has no pose."""
        return self.cameras.pose(self.state, name, frame)

    def T_world_obj(self, name: str) -> SE3 | None:
        """World pose in a scene with metric camera poses; None if not placed or no such poses."""
        return self.cameras.T_world_obj(self.state, name)

    def mesh(self, model_id: str) -> trimesh.Trimesh:
        """Mesh of a model of the library, metres; not to be changed.

        Raises:
            ToolkitError: no such model, or its file is missing or damaged.
        """
        return self.meshes.mesh(self.state.model(model_id))

    def centre(self, model_id: str) -> NDArray[np.float64]:
        """(3,) centre of the bounding box of a model's mesh, mesh frame, metres; see `mesh`."""
        return self.meshes.centre(self.state.model(model_id))
