"""Computations that end in an edit: what needs files, images or a solver."""

from annotator.session.requests.base import (
    Cancelled,
    Outcome,
    Progress,
    Request,
    RequestCancelled,
    Watch,
)
from annotator.session.requests.library import ImportMesh
from annotator.session.requests.points import SolvePnP
from annotator.session.requests.refine import Refine
from annotator.session.requests.support import SnapToTable

AnyRequest = ImportMesh | SolvePnP | Refine | SnapToTable

__all__ = [
    "AnyRequest",
    "Cancelled",
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
