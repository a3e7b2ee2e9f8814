"""The last fit of poses on real depth: `python perf/robust_fit.py`.

Objects of five RealSense frames with their refined poses: coordinates are exact, points are those
of the sensor. Printed are the angle and distance between the fitted and the refined pose, for
RANSAC with 2 cm and least squares over its inliers, and with the weighted last fit.
"""

from __future__ import annotations

import argparse
import re
from pathlib import Path

import numpy as np
from scipy.io import loadmat

from benchmark.methods.pose.fitting import FitOptions, fit_pose
from std_toolkit.geometry import SE3, Camera
from std_toolkit.geometry.depth_maps import unproject_depth
from std_toolkit.geometry.mesh import load_mesh, nocs_frame
from std_toolkit.geometry.se3 import nearest_rotation, rotation_angle
from std_toolkit.io.images import read_png
from std_toolkit.rendering.mesh import prepare_mesh
from std_toolkit.rendering.raycast import RaycastRenderer
from std_toolkit.rendering.renderer import image_window

DATA = Path(__file__).resolve().parent.parent.parent / "shared/data"
LEFT_OUT = "051_large_clamp"
LEAST = 200  # pixels


def camera_of(folder: Path) -> Camera:
    text = (folder / "meta.yml").read_text()
    numbers = [float(x) for x in re.findall(r"-?\d+\.\d+(?:e-?\d+)?", text)]
    K = next(numbers[i : i + 9] for i in range(len(numbers)) if 300 < numbers[i] < 1000)
    return Camera(640, 480, K[0], K[4], K[2], K[5])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--data", type=Path, default=DATA)
    root = parser.parse_args().data
    folder = root / "realsense_ycb_frames"
    camera = camera_of(folder)
    names = sorted(p.name for p in (root / "ycb_meshes").iterdir() if p.is_dir())
    names = [n for n in names if n != LEFT_OUT]
    renderer, rows = RaycastRenderer(), []
    for path in sorted((folder / "reference_poses").glob("*.mat")):
        number = re.findall(r"\d+", path.stem)[-1]
        depth_path = next(p for p in folder.rglob(f"*{number}*depth*.png"))
        depth = read_png(depth_path).astype(np.float32) / 1000
        content = loadmat(path)
        ids = content["rois"][:, 1].astype(int)
        drawn = []
        for class_id, pose in zip(ids, content["poses_refined"], strict=True):
            mesh_path = next((root / "ycb_meshes" / names[class_id - 1]).glob("*.obj"), None)
            mesh_path = mesh_path or next((root / "ycb_meshes" / names[class_id - 1]).glob("*.ply"))
            mesh = load_mesh(mesh_path)
            T = SE3.from_quat(pose[:4], pose[4:7])
            surface = renderer.draw(camera, prepare_mesh(mesh), T, window=image_window(camera))
            drawn.append((names[class_id - 1], mesh, T, surface.depth))
        nearest = np.min([np.where(d > 0, d, np.inf) for *_, d in drawn], axis=0)
        for name, mesh, T, own in drawn:
            mask = (own > 0) & (own <= nearest) & (depth > 0)
            if mask.sum() < LEAST:
                continue
            centre, diagonal = nocs_frame(mesh)
            places = unproject_depth(own, camera)[mask]
            coordinates = (T.inverse() @ places - centre) / diagonal
            points = unproject_depth(depth, camera)[mask]
            errors = []
            for last in ("inliers", "tukey"):
                try:
                    found = fit_pose(coordinates, points, FitOptions(last=last))
                except Exception:
                    errors += [np.nan, np.nan]
                    continue
                M = found.RT
                R = nearest_rotation(M[:3, :3] / np.cbrt(np.linalg.det(M[:3, :3])))
                angle = np.rad2deg(rotation_angle(R.T @ T.R))
                errors += [angle, 1000 * np.linalg.norm(M[:3, 3] - T @ centre)]
            rows.append((path.stem, name, int(mask.sum()), *errors))
    print(f"{'frame':24} {'object':26} {'pixels':>6}   2 cm          weighted")
    for row in rows:
        print("{:24} {:26} {:6} {:6.2f} deg {:5.1f} mm {:6.2f} deg {:5.1f} mm".format(*row))
    table = np.array([row[3:] for row in rows])
    print(
        "medians", np.nanmedian(table, axis=0).round(2), "means", np.nanmean(table, axis=0).round(2)
    )
    print("weighted better in angle:", int((table[:, 2] < table[:, 0]).sum()), "of", len(table))


if __name__ == "__main__":
    main()
