"""Run time of the methods without learning: `python perf/bench_filling.py [--repeats 3]`.

The scene is a table before a wall with boxes and balls on it; 15 % of the depth is missing, in
round holes, in shadows beside the objects and in specks. Times are processor time of one thread per
frame, the least of the repeats, because the machine may be busy. The second table is ClearGrasp's
global optimisation, with exact normals. The third solves the system of colorization in several
ways, with the error of each against the exact solution. BLAS uses one thread.
"""

from __future__ import annotations

import argparse
import os
import time
from collections.abc import Callable
from functools import partial

os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csc_matrix
from scipy.sparse.linalg import LinearOperator, bicgstab, spilu, splu

from benchmark.methods.depth.cleargrasp.global_optimization import optimize_depth
from benchmark.methods.depth.filling.colorization import colorization_system, factorized
from benchmark.methods.protocol import View
from benchmark.methods.registry import make_restorer
from std_toolkit.geometry.camera import Camera, pixel_rays

METHODS = (
    "raw",
    "nearest",
    "navier-stokes",
    "telea",
    "joint-bilateral",
    "colorization",
    "planes",
)
SIZES = ((224, 224), (640, 360), (1280, 720))
OPTIMIZED = ((256, 144), (320, 240), (640, 360))
SYMMETRIC = {"permc_spec": "MMD_AT_PLUS_A", "diag_pivot_thresh": 0.0}
SOLVED = ((320, 180), (640, 360))


def camera_of(size: tuple[int, int]) -> Camera:
    width, height = size
    focal = 0.72 * max(size)
    return Camera(width, height, focal, focal, (width - 1) / 2, (height - 1) / 2)


def scene(size: tuple[int, int]) -> tuple[View, NDArray[np.float64], NDArray[np.float64]]:
    """The view with holes, the whole depth and the normals towards the camera."""
    camera = camera_of(size)
    rays = pixel_rays(camera)
    rng = np.random.default_rng(0)
    wall, table = np.array([0, 0, -1.0]), np.array([0, -0.8, -0.6])
    depth = np.full(rays.shape[:2], 1.6)
    normals = np.broadcast_to(wall, rays.shape).copy()
    shade = np.full(rays.shape, (205, 200, 190), dtype=np.float64)
    down = -0.56 / np.minimum(rays @ table, -1e-9)
    on_table = down < depth
    depth[on_table], normals[on_table], shade[on_table] = down[on_table], table, (120, 85, 60)
    for _ in range(8):
        centre = np.array([rng.uniform(-0.4, 0.4), rng.uniform(0.05, 0.2), rng.uniform(0.7, 1.0)])
        radius = rng.uniform(0.04, 0.09)
        a, b = (rays**2).sum(axis=-1), rays @ centre
        inside = b**2 - a * (centre @ centre - radius**2)
        near = (b - np.sqrt(np.maximum(inside, 0))) / a
        ball = (inside > 0) & (near < depth)
        depth[ball] = near[ball]
        normals[ball] = (rays[ball] * near[ball, None] - centre) / radius
        shade[ball] = rng.uniform(30, 230, 3)
    color = shade * (0.6 + 0.4 * np.maximum(0, -normals @ np.array([0.3, -0.6, 0.74]))[..., None])
    color = np.clip(color + rng.normal(0, 4, color.shape), 0, 255).astype(np.uint8)
    hidden = holes(depth, rng)
    noisy = depth * (1 + rng.normal(0, 0.002, depth.shape))
    return View(color, np.where(hidden, 0, noisy).astype(np.float32), camera), depth, normals


def holes(depth: NDArray[np.float64], rng: np.random.Generator) -> NDArray[np.bool_]:
    """15 % of the pixels: shadows at steps of depth, specks, and discs for the rest."""
    height, width = depth.shape
    reach = max(3, width // 60)
    far = cv2.dilate(depth, np.ones((1, reach)), anchor=(0, 0))
    hidden = (far - depth > 0.05) | (rng.uniform(size=depth.shape) < 0.01)
    v, u = np.mgrid[:height, :width]
    while hidden.mean() < 0.15:
        y, x = rng.uniform(0, height), rng.uniform(0, width)
        hidden |= (v - y) ** 2 + (u - x) ** 2 < rng.uniform(height / 60, height / 9) ** 2
    return np.asarray(hidden)


def milliseconds(run: Callable[[], object], repeats: int) -> float:
    spent = []
    for _ in range(repeats):
        began = time.process_time()
        run()
        spent.append(time.process_time() - began)
    return 1000 * min(spent)


def print_methods(repeats: int) -> None:
    views = [scene(size) for size in SIZES]
    titles = "".join(f"{f'{w}x{h}':>12}" for w, h in SIZES)
    print(f"{'ms a frame':<18}{titles}   error in the holes, mm: median, 90 % ({SIZES[1][0]} wide)")
    for method in METHODS:
        restorer = make_restorer(method)
        line = f"{method:<18}"
        for view, _, _ in views:
            line += f"{milliseconds(lambda r=restorer, v=view: r.restore([v]), repeats):>12.1f}"
        view, true, _ = views[1]
        answer = restorer.restore([view])[0].depth
        error = 1000 * np.abs(answer - true)[(view.depth == 0) & (answer > 0)]
        if len(error):
            middle, high = np.percentile(error, [50, 90])
            line += f"{middle:>12.1f}{high:>8.1f}"
        print(line)


def print_optimization(repeats: int) -> None:
    print(f"\n{'global optimisation':<21}{'ms a frame':>12}{'error in the holes, mm':>26}")
    for size in OPTIMIZED:
        view, true, normals = scene(size)
        found = [np.zeros(0, np.float32)]

        def run(view: View = view, normals: NDArray = normals, found: list = found) -> None:
            found[0] = optimize_depth(view.depth, normals, None, None, view.camera)

        spent = milliseconds(run, repeats)
        error = 1000 * np.abs(found[0] - true)[view.depth == 0]
        print(f"{f'{size[0]}x{size[1]}':<21}{spent:>12.1f}{np.median(error):>26.2f}")


def by_dissection(
    matrix: csc_matrix, right: NDArray[np.float64], missing: NDArray[np.bool_]
) -> NDArray[np.float64]:
    return factorized(matrix, missing)(right)


def by_superlu(matrix: csc_matrix, right: NDArray[np.float64]) -> NDArray[np.float64]:
    return splu(matrix, **SYMMETRIC, options={"SymmetricMode": True}).solve(right)


def by_superlu_as_it_comes(matrix: csc_matrix, right: NDArray[np.float64]) -> NDArray[np.float64]:
    return splu(matrix).solve(right)


def by_bicgstab(matrix: csc_matrix, right: NDArray[np.float64]) -> NDArray[np.float64]:
    return bicgstab(matrix.tocsr(), right, rtol=1e-6, maxiter=5000)[0]


def by_bicgstab_with_ilu(matrix: csc_matrix, right: NDArray[np.float64]) -> NDArray[np.float64]:
    factors = spilu(matrix, drop_tol=1e-3, fill_factor=8, **SYMMETRIC)
    operator = LinearOperator(matrix.shape, factors.solve)
    return bicgstab(matrix.tocsr(), right, rtol=1e-6, M=operator)[0]


SOLVERS = {
    "SuperLU, symmetric ordering": by_superlu,
    "SuperLU, default ordering": by_superlu_as_it_comes,
    "BiCGSTAB": by_bicgstab,
    "BiCGSTAB, incomplete LU": by_bicgstab_with_ilu,
}


def print_solvers(repeats: int) -> None:
    print(f"\n{'colorization, solved by':<34}{'unknowns':>9}{'ms':>9}{'most wrong, mm':>16}")
    for size in SOLVED:
        view, true, _ = scene(size)
        sparse = np.random.default_rng(0).uniform(size=true.shape) > 0.02
        for title, missing in (("15 % missing", view.depth == 0), ("98 % missing", sparse)):
            matrix, right = colorization_system(view.color, np.where(missing, 0, true), missing)
            exact = factorized(matrix, missing)(right)
            own = partial(by_dissection, missing=missing)
            print(f"{size[0]}x{size[1]}, {title}")
            for name, solve in {"nested dissection (in use)": own, **SOLVERS}.items():
                wrong = 1000 * np.abs(solve(matrix, right) - exact).max()
                spent = milliseconds(partial(solve, matrix, right), repeats)
                print(f"  {name:<32}{len(exact):>9}{spent:>9.0f}{wrong:>16.3f}")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--repeats", type=int, default=3)
    repeats = parser.parse_args().repeats
    cv2.setNumThreads(1)
    print_methods(repeats)
    print_optimization(repeats)
    print_solvers(repeats)


if __name__ == "__main__":
    main()
