"""Aids to place objects whose depth is missing or wrong: table, other objects, point cloud."""

from std_toolkit.labels.support.penetration import (
    TABLE,
    Penetration,
    find_penetrations,
    prepare_objects,
)
from std_toolkit.labels.support.plane import Plane, TablePlane, TableSearch, snap_to_plane
from std_toolkit.labels.support.solid import PlacedObject
from std_toolkit.labels.support.table import find_table, search_table
from std_toolkit.rendering.point_cloud import (
    FusedCloud,
    FusionCancelled,
    frame_cloud,
    fuse_clouds,
    sparse_points,
)

__all__ = [
    "TABLE",
    "FusedCloud",
    "FusionCancelled",
    "Penetration",
    "PlacedObject",
    "Plane",
    "TablePlane",
    "TableSearch",
    "find_penetrations",
    "find_table",
    "frame_cloud",
    "fuse_clouds",
    "prepare_objects",
    "search_table",
    "snap_to_plane",
    "sparse_points",
]
