"""Images of a scene, read when they are needed and kept within a bound."""

from annotator.app.image_cache import FrameImage, ImageCache

__all__ = ["FrameImage", "ImageCache"]
