"""How meshes and clouds are drawn; shared by all views of a session."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum


class Mode(StrEnum):
    """What the main view shows."""

    IMAGE = "image"
    CLOUD = "cloud"


class Style(StrEnum):
    """How a mesh lies over the image."""

    SOLID = "solid"
    WIREFRAME = "wireframe"
    CONTOUR = "contour"


class CloudSource(StrEnum):
    """Which points the cloud shows."""

    FRAME = "frame"
    FUSED = "fused"


class Gizmo(StrEnum):
    """Handles on the selected object."""

    OFF = "off"
    MOVE = "move"
    TURN = "turn"


@dataclass(frozen=True, kw_only=True)
class ViewOptions:
    """How the views draw.

    Attributes:
        opacity: of solid meshes over the image, 0.1 to 1.
        blink: the meshes come and go, so that the image beneath can be compared.
        hidden: the meshes are not drawn at all.
        only_selected: the other objects are not drawn.
        table: the table plane is drawn in the cloud.
        penetration: where objects run into each other they are painted red.
        contour_always: the contour is drawn over solid and wireframe meshes, too.
    """

    style: Style = Style.SOLID
    opacity: float = 0.55
    blink: bool = False
    hidden: bool = False
    only_selected: bool = False
    cloud: CloudSource = CloudSource.FRAME
    table: bool = True
    penetration: bool = True
    contour_always: bool = False
