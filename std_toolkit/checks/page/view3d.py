"""The interactive 3D view of the report: cameras, points and labelled objects, upright.

Points and triangles are reduced to a size that suits a web page.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from std_toolkit.checks.measure.contours import mesh_problem
from std_toolkit.geometry.mesh import decimate_mesh
from std_toolkit.html.plots import CAMERA, GRID, base_layout, figure_json, object_color
from std_toolkit.rendering.point_cloud import fuse_clouds, sparse_points
from std_toolkit.scene import Frame, Scene

Array = NDArray[np.float64]

MOST_FRUSTA = 40

# Points farther from the objects than this times the farthest camera are omitted.
ROOM = 0.9

MOST_POINTS = 12000

MOST_FACES = 900

FUSED_FRAMES = 5

VOXEL_M = 0.006


def scene_figure(scene: Scene, up: Array, sparse: Cloud | None, fused: Cloud | None) -> str | None:
    """Cameras as frusta, points and meshes; None without camera poses.

    Args:
        scene: the scene.
        up: unit vector that points up in the world.
        sparse: points of the reconstruction.
        fused: sensor depth in the world.
    """
    frames = scene.registered_frames()
    if not frames:
        return None
    ids = [o.id for o in scene.objects.objects]
    meshes = {i: m for i in ids if (m := labelled_mesh(scene, i)) is not None}
    centre = _middle(scene, meshes, sparse or fused)
    turn = _upright(up, scene, frames[0], centre)
    cameras = [T for f in frames if (T := scene.T_world_cam(f.id)) is not None]
    reach = ROOM * max(float(np.linalg.norm(T.t - centre)) for T in cameras)

    traces: list[dict[str, Any]] = []
    if fused is not None:
        traces.append(
            _points(
                near_points(fused, centre, reach),
                "sensor depth",
                turn,
                centre,
                size=1.6,
                shown=True,
            )
        )
    if sparse is not None:
        # With sensor depth, sparse points are hidden until selected in the legend.
        traces.append(
            _points(
                near_points(sparse, centre, reach),
                "reconstructed points",
                turn,
                centre,
                size=1.8,
                shown=fused is None,
            )
        )
    for item in scene.objects.objects:
        if item.id in meshes:
            vertices, faces = meshes[item.id]
            xyz = ((vertices - centre) @ turn.T).astype(np.float32)
            traces.append(
                {
                    "type": "mesh3d",
                    "name": item.name,
                    "x": xyz[:, 0],
                    "y": xyz[:, 1],
                    "z": xyz[:, 2],
                    "i": faces[:, 0],
                    "j": faces[:, 1],
                    "k": faces[:, 2],
                    "color": object_color(ids, item.id),
                    "opacity": 0.9,
                    "flatshading": True,
                    "lighting": {"ambient": 0.8, "diffuse": 0.5, "specular": 0.05},
                    "lightposition": {"x": 0, "y": -1000, "z": 3000},
                    "showlegend": True,
                    "hoverinfo": "name",
                }
            )
    traces += _cameras(scene, frames, turn, centre)
    layout = base_layout(
        height=620,
        margin={"l": 0, "r": 0, "t": 0, "b": 0},
        legend={
            "orientation": "v",
            "x": 0.01,
            "y": 0.99,
            "yanchor": "top",
            "xanchor": "left",
            "bgcolor": "rgba(255,255,255,0.85)",
            "bordercolor": GRID,
            "borderwidth": 1,
            "itemsizing": "constant",
        },
        scene={
            "aspectmode": "data",
            "xaxis": _axis("x (m)"),
            "yaxis": _axis("y (m)"),
            "zaxis": _axis("up (m)"),
            "camera": {
                "eye": {"x": 0.88, "y": -1.26, "z": 0.82},
                "up": {"x": 0, "y": 0, "z": 1},
                "center": {"x": 0, "y": 0, "z": -0.1},
            },
            "dragmode": "orbit",
        },
        showlegend=True,
    )
    del layout["xaxis"], layout["yaxis"]
    return figure_json(traces, layout)


def _cameras(scene: Scene, frames: list[Frame], turn: Array, centre: Array) -> list[dict[str, Any]]:
    """The path through all cameras, and frusta of evenly spaced ones as one line trace."""
    positions, names = [], []
    for frame in frames:
        T = scene.T_world_cam(frame.id)
        assert T is not None
        positions.append(turn @ (T.t - centre))
        names.append(f"frame {frame.id} ({frame.name})")
    path = np.array(positions, dtype=np.float32)
    distance = float(np.median(np.linalg.norm(path, axis=1)))
    size = np.clip(0.06 * distance, 0.01, 0.2)
    chosen = np.unique(np.linspace(0, len(frames) - 1, MOST_FRUSTA).round().astype(int))
    lines: list[Array] = []
    gap = np.full((1, 3), np.nan)
    for index in chosen:
        frame = frames[index]
        camera, T = scene.camera(frame), scene.T_world_cam(frame.id)
        assert T is not None
        w, h = camera.width - 0.5, camera.height - 0.5
        corners = camera.without_distortion().unproject(
            np.array([[-0.5, -0.5], [w, -0.5], [w, h], [-0.5, h]]), 1.0
        )
        c = ((T @ (corners * size)) - centre) @ turn.T
        apex = (turn @ (T.t - centre))[None]
        lines += [c, c[:1], gap]
        for corner in c:
            lines += [apex, corner[None], gap]
    frusta = np.concatenate(lines).astype(np.float32)
    return [
        {
            "type": "scatter3d",
            "mode": "lines",
            "name": "cameras",
            "x": frusta[:, 0],
            "y": frusta[:, 1],
            "z": frusta[:, 2],
            "line": {"color": CAMERA, "width": 1.5},
            "hoverinfo": "skip",
        },
        {
            "type": "scatter3d",
            "mode": "lines+markers",
            "name": "camera path",
            "x": path[:, 0],
            "y": path[:, 1],
            "z": path[:, 2],
            "line": {"color": "#9aa5b1", "width": 3},
            "marker": {"size": 2.5, "color": CAMERA},
            "text": names,
            "hovertemplate": "%{text}<extra></extra>",
        },
    ]


def _points(
    cloud: Cloud, name: str, turn: Array, centre: Array, *, size: float, shown: bool
) -> dict[str, Any]:
    xyz = ((cloud.xyz - centre) @ turn.T).astype(np.float32)
    return {
        "type": "scatter3d",
        "mode": "markers",
        "name": name,
        "x": xyz[:, 0],
        "y": xyz[:, 1],
        "z": xyz[:, 2],
        "marker": {"size": size, "color": [f"#{r:02x}{g:02x}{b:02x}" for r, g, b in cloud.rgb]},
        "hoverinfo": "skip",
        "visible": True if shown else "legendonly",
    }


def _axis(title: str) -> dict[str, Any]:
    return {
        "title": {"text": title},
        "gridcolor": GRID,
        "zeroline": False,
        "showbackground": False,
        "showspikes": False,
    }


def _middle(
    scene: Scene,
    meshes: dict[int, tuple[NDArray[np.float32], NDArray[np.int32]]],
    cloud: Cloud | None,
) -> Array:
    """The centre of rotation: that of the objects, else of the points, else of the cameras."""
    if meshes:
        return np.mean([v.mean(axis=0) for v, _ in meshes.values()], axis=0).astype(np.float64)
    if cloud is not None:
        return np.median(cloud.xyz, axis=0).astype(np.float64)
    poses = [scene.T_world_cam(f.id) for f in scene.registered_frames()]
    return np.mean([T.t for T in poses if T is not None], axis=0)


def _upright(up: Array, scene: Scene, first: Frame, centre: Array) -> Array:
    """Rotation whose third row is up and whose second row points away from the first camera."""
    T = scene.T_world_cam(first.id)
    assert T is not None
    away = centre - T.t
    away = away - (away @ up) * up
    if np.linalg.norm(away) < 1e-6:
        away = np.cross(up, [1.0, 0.0, 0.0] if abs(up[0]) < 0.9 else [0.0, 1.0, 0.0])
    away = away / np.linalg.norm(away)
    return np.stack([np.cross(away, up), away, up])


@dataclass(frozen=True, eq=False)
class Cloud:
    """Points of the world: xyz (N, 3) metres, rgb (N, 3) uint8."""

    xyz: NDArray[np.float32]
    rgb: NDArray[np.uint8]


def sparse_cloud(scene: Scene) -> Cloud | None:
    """The points of the reconstruction (poses/points.ply); None if there are none."""
    found = sparse_points(scene)
    return None if found is None else _thinned(*found)


def fused_cloud(scene: Scene, frames: list[Frame]) -> Cloud | None:
    """World points of sensor depth in evenly spaced frames; None without depth or metric scale."""
    usable = [f for f in frames if f.depth is not None and scene.T_world_cam(f.id) is not None]
    # Depth is in metres: it cannot be placed in a world of unknown unit.
    scale = None if scene.poses is None else scene.poses.scale
    if not usable or (scale is not None and scale.unit != "metre"):
        return None
    chosen = np.unique(np.linspace(0, len(usable) - 1, FUSED_FRAMES).round().astype(int))
    cloud = fuse_clouds(scene, [usable[i] for i in chosen], voxel_m=VOXEL_M, limit=2 * MOST_POINTS)
    return _thinned(cloud.points, cloud.colors) if len(cloud.points) else None


def labelled_mesh(
    scene: Scene, object_id: int
) -> tuple[NDArray[np.float32], NDArray[np.int32]] | None:
    """Vertices (V, 3) in the world and faces (F, 3) of an object, decimated.

    None without a label or a readable mesh.
    """
    T_world_obj = scene.T_world_obj(object_id)
    if T_world_obj is None or mesh_problem(scene, scene.objects.object(object_id).model):
        return None
    mesh = decimate_mesh(scene.mesh(scene.objects.object(object_id).model), MOST_FACES)
    vertices = T_world_obj @ np.asarray(mesh.vertices)
    return vertices.astype(np.float32), np.asarray(mesh.faces, dtype=np.int32)


def near_points(cloud: Cloud, centre: NDArray[np.floating], radius_m: float) -> Cloud:
    """The points within a radius, so that a far wall does not make the scene small."""
    near = np.linalg.norm(cloud.xyz - centre, axis=1) <= radius_m
    return Cloud(cloud.xyz[near], cloud.rgb[near])


def _thinned(xyz: NDArray[np.floating], rgb: NDArray[np.uint8]) -> Cloud:
    """At most `MOST_POINTS` points without far outliers, chosen deterministically."""
    middle = np.median(xyz, axis=0)
    distance = np.linalg.norm(xyz - middle, axis=1)
    near = distance <= 6 * max(float(np.median(distance)), 1e-6)
    xyz, rgb = xyz[near], rgb[near]
    if len(xyz) > MOST_POINTS:
        keep = np.sort(np.random.default_rng(0).choice(len(xyz), MOST_POINTS, replace=False))
        xyz, rgb = xyz[keep], rgb[keep]
    return Cloud(xyz.astype(np.float32), rgb)
