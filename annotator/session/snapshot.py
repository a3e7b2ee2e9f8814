"""A session as it was at one moment, for work in another thread."""

from __future__ import annotations

from annotator.session.cameras import Cameras
from annotator.session.meshes import MeshLibrary
from annotator.session.queries import Queries
from annotator.session.state import AnnotationState
from std_toolkit.scene import Model, Object, ObjectTable, Scene


class Snapshot(Queries):
    """Immutable: what the session does later does not reach it.

    Attributes:
        scene: the scene with the models and objects of the state, also those that are not saved
            yet; for cameras, images and depth. It has no labels: `pose` tells where objects are.
        writable: files may be added to the scene folder.
        annotator: who edits.
    """

    def __init__(
        self,
        scene: Scene,
        state: AnnotationState,
        cameras: Cameras,
        meshes: MeshLibrary,
        *,
        writable: bool,
        annotator: str,
    ) -> None:
        self.scene = scene.copy(objects=object_table(state))
        self.writable = writable
        self.annotator = annotator
        self._state, self._cameras, self._meshes = state, cameras, meshes

    def with_model(self, model: Model) -> Snapshot:
        """A copy with one more model, such as the first of several meshes that are added."""
        return Snapshot(
            self.scene,
            self._state.with_model(model),
            self._cameras,
            self._meshes,
            writable=self.writable,
            annotator=self.annotator,
        )

    @property
    def state(self) -> AnnotationState:
        return self._state

    @property
    def cameras(self) -> Cameras:
        return self._cameras

    @property
    def meshes(self) -> MeshLibrary:
        return self._meshes


def object_table(state: AnnotationState) -> ObjectTable:
    """objects.json of a state."""
    return ObjectTable(
        models=state.models,
        objects=[
            Object(id=o.id, name=o.name, model=o.model, material=o.material) for o in state.objects
        ],
    )
