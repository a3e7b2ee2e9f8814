"""Comparison of simulated and real depth: `python perf/realism.py [--scenes 4] [--data DIR]`.

Three tables of completeness, median error, root mean square of the error and share of values off by
more than a centimetre. Controlled: all 36 diffuse materials as tiles of a board at 0.6 m, and every
metal, other specular, glass and some diffuse materials as vessels at 0.6 m. Random: scenes as
`std-sim` makes them, by material class. Real: captures of a D415, a D435 and another RealSense,
where the folder of real recordings is (STD_TEST_DATA, or ../shared/data).

Glass: what a camera measures where something transparent is, by kind of glass beside the capture
that is most like it: 123 (ClearGrasp) and the D415's bottle set the materials' ranges, 080 and 130
only judge. Bounds: holes and errors that real cameras do not exceed; the exit status is 1 where the
simulator does.

"clear" pixels are on surfaces visible in both cameras, a matching window away from steps in depth:
the strip at the left edge, shadows and borders are holes of any stereo camera.
"""

from __future__ import annotations

import argparse
import os
import sys
from collections import defaultdict
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pandas as pd
import scipy.io
from numpy.typing import NDArray

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))
from perf.clear_depth import glass
from perf.dotted_plane import measure_plane
from perf.trial import (
    CAMERA,
    SENSOR,
    VESSELS,
    WINDOW_PX,
    TrialScene,
    TrialView,
    measurable_pixels,
    render_view,
    small_holes,
    tiles,
    vessels,
)
from sensors.materials.material_library import MaterialClass, load_library
from sensors.pattern import make_pattern
from sensors.render.sim_renderer import DRAFT_INFRARED
from sensors.simulation.options import SimulationOptions
from sensors.simulation.set_report import ErrorTally
from sensors.simulation.simulated_set import parts_cache
from sensors.simulation.simulator import Simulator
from sensors.stereo import disparity_to_depth, make_matcher
from std_toolkit.geometry.camera import Camera
from std_toolkit.geometry.mesh import load_mesh
from std_toolkit.geometry.se3 import SE3
from std_toolkit.io.exr import read_exr_depth
from std_toolkit.io.images import read_depth, read_png
from std_toolkit.rendering.maps import compose
from std_toolkit.rendering.mesh import RenderMesh
from std_toolkit.rendering.raycast import RaycastRenderer
from std_toolkit.rendering.renderer import PlacedMesh

IN_A_VIEW = 6
DIFFUSE_VESSELS = 12
TWINS, OWN = "D435, painted twins", "D415, cloth with things, its own depth"
WITHOUT_TRUTH = (f"{TWINS}, all", f"{TWINS}, core", OWN)
"""Captures without reference depth: completeness only."""
Tables = defaultdict[str, ErrorTally]


def clear_of(exact: NDArray[np.floating], camera: Camera = CAMERA) -> NDArray[np.bool_]:
    return measurable_pixels(exact, focal_px=camera.fx, baseline_m=SENSOR.baseline_m)


def add(
    table: Tables,
    name: str,
    depth: NDArray[np.floating],
    exact: NDArray[np.floating],
    where: NDArray[np.bool_],
) -> None:
    """Count pixels of a surface, all of them and the clear ones."""
    table[f"{name}, all"].add(depth[where], exact[where])
    clear = where & clear_of(exact)
    table[f"{name}, clear"].add(depth[clear], exact[clear])


def controlled(renderer: Any, seeds: int) -> tuple[Tables, Tables, list[TrialView]]:
    """Tables by kind of surface and by diffuse material, and the views."""
    table, materials = Tables(ErrorTally), Tables(ErrorTally)
    views = []
    for seed in range(seeds):
        board = tiles(CAMERA, seed)
        view = render_view(board, SENSOR, CAMERA, renderer, options=DRAFT_INFRARED, seed=seed)
        views.append(view)
        add(table, "diffuse tiles", view.depth, view.exact, view.exact > 0)
        clear = clear_of(view.exact)
        for i, material in enumerate(board.materials):
            where = clear & (view.mask == i + 1)
            materials[material.name].add(view.depth[where], view.exact[where])
    library = load_library()
    things: list[tuple[MaterialClass, str, str]] = []
    for material_class in ("diffuse", "specular"):
        names = [m.name for m in library.of_class(material_class)]
        chosen = names[:: len(names) // DIFFUSE_VESSELS] if material_class == "diffuse" else names
        things += [(material_class, n, VESSELS[i % 3]) for i, n in enumerate(chosen)]
    glasses = [m.name for m in library.of_class("transparent")]
    things += [("transparent", name, category) for name in glasses for category in VESSELS]
    order = np.random.default_rng(0).permutation(len(things))
    families = {m.name: m.family for m in library.opaque}
    for start in range(0, len(things), IN_A_VIEW):
        chosen_now = [things[int(i)] for i in order[start : start + IN_A_VIEW]]
        trial = vessels(chosen_now, start)
        view = render_view(
            trial, SENSOR, CAMERA, renderer, options=DRAFT_INFRARED, seed=100 + start
        )
        views.append(view)
        for i, (material_class, name, _) in enumerate(chosen_now):
            metal = families.get(name) == "metal"
            kind = {"specular": "metal" if metal else "glossy", "transparent": "glass"}
            where = (view.mask == i + 1) & (view.exact > 0)
            label = f"{kind.get(material_class, 'diffuse')} vessels"
            add(table, label, view.depth, view.exact, where)
        floor = (view.mask == 0) & (view.exact > 0)
        add(table, "floors below them", view.depth, view.exact, floor)
    return table, materials, views


def random_scenes(renderer: Any, scenes: int, views: int) -> Tables:
    """By material class, in the left infrared camera."""
    table = Tables(ErrorTally)
    simulator = Simulator(SimulationOptions(views=views), parts_cache=parts_cache())
    for seed in range(scenes):
        world = simulator.world(seed, f"{seed:05d}")
        classes = {o.instance_id: o.material_class for o in world.record.objects}
        for index, T_world_cam in enumerate(world.T_world_cam):
            # Without the colour image a view takes half the time.
            eye = T_world_cam @ SENSOR.pose_of_color.inverse()
            trial = TrialScene(world.scene, eye, ())
            number = 100 * seed + index
            view = render_view(trial, SENSOR, CAMERA, renderer, options=DRAFT_INFRARED, seed=number)
            for name in ("raw", "diffuse", "specular", "transparent", "floor"):
                ids = [0] if name == "floor" else [i for i, c in classes.items() if c == name]
                where = np.isin(view.mask, ids) & (view.exact > 0)
                add(table, name, view.depth, view.exact, where)
    return table


def real_captures(data: Path) -> Tables:
    """Tables of real captures."""
    table = Tables(ErrorTally)
    for name in ("080", "123", "130"):
        stem = data / "cleargrasp_real" / "real-val" / f"000000{name}"
        clear, twin = (
            np.nan_to_num(read_exr_depth(Path(f"{stem}-{kind}-depth-img.exr")))
            for kind in ("transparent", "opaque")
        )
        mask = np.asarray(read_png(Path(f"{stem}-mask.png")), np.uint8)
        inside = (mask if mask.ndim == 2 else mask[..., 0]) > 0
        # Two windows, for these images are twice as large.
        width = 4 * WINDOW_PX + 1
        near = cv2.dilate(inside.astype(np.uint8), np.ones((width, width), np.uint8)) > 0
        core = cv2.erode(inside.astype(np.uint8), np.ones((width, width), np.uint8)) > 0
        label = f"D435, glass {name}"
        table[f"{label}, all"].add(clear[inside & (twin > 0)], twin[inside & (twin > 0)])
        table[f"{TWINS}, all"].add(twin[inside], twin[inside])
        table[f"{TWINS}, core"].add(twin[core], twin[core])
        around = ~near & (twin > 0)
        table["D435, table around, twice measured"].add(clear[around], twin[around])
    add_d415(table, data / "d415_stereo_pair")
    add_ycb(table, data)
    return table


def add_d415(table: Tables, folder: Path) -> None:
    """The camera's own depth, and the local matcher's against it."""
    left, right = (read_png(folder / f"0000_ir_{side}.png")[..., 0] for side in "lr")
    depth = read_depth(folder / "0000_depth.png", scale=0.001)
    found = make_matcher("local").match(left.astype(np.uint8), right.astype(np.uint8))
    # The camera's depth is 1.2 % above what its own focal length and baseline give.
    own = 1.012 * disparity_to_depth(found, focal_px=CAMERA.fx, baseline_m=SENSOR.baseline_m)
    table[OWN].add(depth.ravel(), depth.ravel())
    both = depth > 0
    table["D415, our matcher against its depth"].add(own[both], depth[both])


def add_ycb(table: Tables, data: Path) -> None:
    """Depth of household objects against meshes at refined poses, including the pose error."""
    camera = Camera(640, 480, 618.0172729492188, 618.0033569335938, 312.376953125, 232.37530517578)
    meshes = data / "ycb_meshes"
    names = sorted(p.name for p in meshes.iterdir() if p.is_dir() and p.name != "051_large_clamp")
    renderer = RaycastRenderer()
    for index in range(4):
        folder = data / "realsense_ycb_frames"
        reference = scipy.io.loadmat(str(folder / "reference_poses" / f"{index:06d}-color.png.mat"))
        raw = read_depth(folder / f"{index:06d}-depth.png", scale=0.001)
        placed: list[PlacedMesh] = []
        for row, pose in zip(reference["rois"], reference["poses_refined"], strict=True):
            mesh = load_mesh(meshes / names[int(row[1]) - 1] / "textured.obj")
            prepared = RenderMesh.from_arrays(np.asarray(mesh.vertices), np.asarray(mesh.faces))
            T = SE3.from_quat(pose[:4], pose[4:7])
            placed.append(PlacedMesh(len(placed) + 1, prepared, T))
        exact = compose(renderer, camera, placed).depth
        where = exact > 0
        core = cv2.erode(where.astype(np.uint8), np.ones((15, 15), np.uint8)) > 0
        table["RealSense, household things, all"].add(raw[where], exact[where])
        table["RealSense, household things, core"].add(raw[core], exact[core])


def bounds(renderer: Any, scenes: int) -> bool:
    """Print the bounds that real cameras set; whether all are kept."""
    kept = True

    def tell(name: str, value: float, low: float, high: float) -> None:
        nonlocal kept
        kept &= low <= value <= high
        verdict = "" if low <= value <= high else "MISSED"
        print(f"{name:58s} {value:8.3f}   {low:g} to {high:g}   {verdict}")

    planes = {
        noise: [
            100 * measure_plane(SENSOR, make_pattern(SENSOR, seed=s), noise=noise, seed=s).holes
            for s in range(10)
        ]
        for noise in (False, True)
    }
    tell("plane, ten patterns, no noise: largest share of holes, %", max(planes[False]), 0, 0.2)
    tell("plane, ten patterns, sensor noise: largest share, %", max(planes[True]), 0, 0.3)
    simulator = Simulator(SimulationOptions(views=1), parts_cache=parts_cache())
    holes, floor = [], ErrorTally()
    for seed in range(scenes):
        world = simulator.world(seed, f"{seed:05d}")
        eye = world.T_world_cam[0] @ SENSOR.pose_of_color.inverse()
        trial = TrialScene(world.scene, eye, ())
        view = render_view(trial, SENSOR, CAMERA, renderer, options=DRAFT_INFRARED, seed=seed)
        holes.append(100 * small_holes((view.depth == 0) & (view.exact > 0)).mean())
        near = clear_of(view.exact) & (view.mask == 0) & (view.exact > 0.5) & (view.exact < 0.9)
        floor.add(view.depth[near], view.exact[near])
    tell(f"{scenes} random scenes: holes of < 80 pixels, % of all pixels", np.mean(holes), 0.2, 1)
    tell("their floors at 0.5 to 0.9 m, clear: complete, %", floor.row()["complete %"], 98, 100)
    tell("the same: median error, mm", floor.row()["median mm"], 0, 1)
    return kept


def shown(table: Tables) -> str:
    rows = pd.DataFrame({name: tally.row() for name, tally in table.items()}).T
    rows["pixels"] = rows["pixels"].astype(int)
    rows.loc[rows.index.isin(WITHOUT_TRUTH), ["median mm", "RMSE mm", "off by > 1 cm %"]] = np.nan
    return rows.to_string(float_format="%.2f")


def contrast(image: NDArray[np.uint8]) -> float:
    """Median over windows of 21 pixels of deviation over mean."""
    grey = image.astype(np.float32)
    mean = cv2.blur(grey, (21, 21))
    deviation = np.sqrt(np.maximum(cv2.blur(grey * grey, (21, 21)) - mean * mean, 0))
    return float(np.median(deviation / np.maximum(mean, 1)))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--boards", type=int, default=3)
    parser.add_argument("--scenes", type=int, default=4)
    parser.add_argument("--views", type=int, default=2)
    parser.add_argument("--only", choices=("glass", "bounds"), help="print one table")
    parser.add_argument("--data", type=Path, default=None)
    options = parser.parse_args()

    from sensors.render.mitsuba_renderer import MitsubaRenderer

    renderer = MitsubaRenderer()
    data = options.data or Path(os.environ.get("STD_TEST_DATA", "../shared/data"))
    if options.only != "bounds":
        print("where glass is: shares of the pixels with the background 15 mm or more behind")
        print(glass(renderer, data, options.views).to_string(float_format="%.3f"), "\n")
    if options.only != "glass" and not bounds(renderer, options.scenes):
        raise SystemExit(1)
    if options.only:
        return
    table, materials, views = controlled(renderer, options.boards)
    print(f"controlled, at 0.6 m, {options.boards} boards\n{shown(table)}\n")
    worst = sorted(materials.items(), key=lambda item: item[1].row()["complete %"])[:6]
    print(f"least complete diffuse materials\n{shown(Tables(None, worst))}\n")
    dots = [contrast(view.left) for view in views]
    print(f"contrast of the dots: {np.min(dots):.2f} to {np.max(dots):.2f}, ", end="")
    print(f"median {np.median(dots):.2f}\n")
    if options.scenes:
        print(f"random, {options.scenes} scenes of {options.views} views")
        print(shown(random_scenes(renderer, options.scenes, options.views)), "\n")
    if not data.is_dir():
        print(f"no real recordings at {data}")
        return
    print(f"real\n{shown(real_captures(data))}")
    left = read_png(data / "d415_stereo_pair" / "0000_ir_l.png")[..., 0]
    print(f"contrast of the dots: {contrast(left.astype(np.uint8)):.2f}")


if __name__ == "__main__":
    main()
