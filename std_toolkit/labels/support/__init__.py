"""What guides an object whose depth is missing or wrong: the table, its neighbours, the cloud."""

from std_toolkit.labels.support.cloud import (
    FusedCloud,
    FusionCancelled,
    frame_cloud,
    fuse_clouds,
    sparse_points,
)
from std_toolkit.labels.support.penetration import (
    TABLE,
    Penetration,
    find_penetrations,
    prepare_things,
)
from std_toolkit.labels.support.plane import Plane, TablePlane, TableSearch, find_table
from std_toolkit.labels.support.snap import snap_to_plane
from std_toolkit.labels.support.solid import PlacedThing
from std_toolkit.labels.support.table import search_table

__all__ = [
    "TABLE",
    "FusedCloud",
    "FusionCancelled",
    "Penetration",
    "PlacedThing",
    "Plane",
    "TablePlane",
    "TableSearch",
    "find_penetrations",
    "find_table",
    "frame_cloud",
    "fuse_clouds",
    "prepare_things",
    "search_table",
    "snap_to_plane",
    "sparse_points",
]
