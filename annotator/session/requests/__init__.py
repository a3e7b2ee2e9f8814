"""Requests: computations with files, images or a solver whose result is an edit."""

from annotator.session.requests.carry_request import CarryOver
from annotator.session.requests.mesh_requests import (
    Cancelled,
    ImportMesh,
    Outcome,
    Progress,
    Request,
    RequestCancelled,
    Watch,
)
from annotator.session.requests.pose_requests import Refine, SnapToTable, SolvePnP

AnyRequest = ImportMesh | SolvePnP | Refine | SnapToTable | CarryOver

__all__ = [
    "AnyRequest",
    "Cancelled",
    "CarryOver",
    "ImportMesh",
    "Outcome",
    "Progress",
    "Refine",
    "Request",
    "RequestCancelled",
    "SnapToTable",
    "SolvePnP",
    "Watch",
]
