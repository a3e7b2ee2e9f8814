"""VTK rendering and mouse interaction of an annotation session, without Qt."""

from annotator.views.model_view import ModelView
from annotator.views.scene_view import SceneView
from annotator.views.thumbnails import model_picture
from annotator.views.viewset import ViewSet

__all__ = ["ModelView", "SceneView", "ViewSet", "model_picture"]
