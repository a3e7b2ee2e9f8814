"""Files and geometry of the core against a naive reference, in one run: `python perf/core.py`.

Prints the median time of each and its speed relative to the reference. The reference does not use
this package: another library for files, a plain loop or formula for geometry.
"""

from __future__ import annotations

import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import OpenEXR
from PIL import Image

from std_toolkit.geometry import Camera, ransac_similarity, so3_exp, umeyama, undistort_image
from std_toolkit.io.exr import read_exr, write_exr
from std_toolkit.io.images import read_color, read_png, write_color, write_png

WIDTH, HEIGHT = 1280, 720
REPEATS = 5


def median_ms(work: Callable[[], object]) -> float:
    work()
    times = []
    for _ in range(REPEATS):
        began = time.perf_counter()
        work()
        times.append(1000 * (time.perf_counter() - began))
    return float(np.median(times))


def file_rows(folder: Path) -> list[tuple[str, Callable[[], object], Callable[[], object]]]:
    rng = np.random.default_rng(0)
    v, u = np.mgrid[:HEIGHT, :WIDTH]
    inside = (u - 640) ** 2 + (v - 360) ** 2 < 250**2  # maps are empty around the objects
    depth = np.where(inside, 0.7 + 1e-4 * u, 0).astype(np.float32)
    units = (depth * 10_000).astype(np.uint16)
    nocs = np.stack([units, units[::-1], units[:, ::-1]], axis=-1)
    smooth = cv2.resize(rng.integers(0, 256, (18, 32, 3), dtype=np.uint8), (WIDTH, HEIGHT))
    colour = np.clip(smooth + rng.normal(0, 3, smooth.shape), 0, 255).astype(np.uint8)
    ours, plain = folder / "ours", folder / "plain"
    ours.mkdir()
    plain.mkdir()

    def exr_plain_write() -> None:
        header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
        OpenEXR.File(header, {"Y": depth}).write(str(plain / "d.exr"))

    def exr_plain_read() -> object:
        with OpenEXR.File(str(plain / "d.exr"), separate_channels=True) as file:
            return file.channels()["Y"].pixels.copy()

    def png_three_channels() -> None:
        # Pillow cannot write 16-bit colour: the reference writes three grey files instead.
        for i in range(3):
            Image.fromarray(np.ascontiguousarray(nocs[..., i])).save(plain / f"n{i}.png")

    return [
        (
            "write colour JPEG",
            lambda: write_color(ours / "c.jpg", colour),
            lambda: Image.fromarray(colour).save(plain / "c.jpg", quality=95),
        ),
        (
            "read colour JPEG",
            lambda: read_color(ours / "c.jpg"),
            lambda: np.asarray(Image.open(plain / "c.jpg").convert("RGB")),
        ),
        (
            "write colour PNG",
            lambda: write_color(ours / "c.png", colour),
            lambda: Image.fromarray(colour).save(plain / "c.png"),
        ),
        (
            "read colour PNG",
            lambda: read_color(ours / "c.png"),
            lambda: np.asarray(Image.open(plain / "c.png").convert("RGB")),
        ),
        (
            "write depth PNG16",
            lambda: write_png(ours / "d.png", units),
            lambda: Image.fromarray(units).save(plain / "d.png"),
        ),
        (
            "read depth PNG16",
            lambda: read_png(ours / "d.png"),
            lambda: np.asarray(Image.open(plain / "d.png")),
        ),
        ("write NOCS PNG16", lambda: write_png(ours / "n.png", nocs), png_three_channels),
        ("write depth EXR", lambda: write_exr(ours / "d.exr", {"Y": depth}), exr_plain_write),
        ("read depth EXR", lambda: read_exr(ours / "d.exr"), exr_plain_read),
    ]


def umeyama_by_loop(p: np.ndarray, q: np.ndarray) -> np.ndarray:
    covariance = np.zeros((3, 3))
    mean_p, mean_q = p.mean(axis=0), q.mean(axis=0)
    for a, b in zip(p, q, strict=True):
        covariance += np.outer(b - mean_q, a - mean_p)
    U, _, Vt = np.linalg.svd(covariance)
    return U @ np.diag([1, 1, np.sign(np.linalg.det(U @ Vt))]) @ Vt


def ransac_of_fixed_length(p: np.ndarray, q: np.ndarray) -> np.ndarray:
    """128 samples of 5 points without early stop, as in common implementations."""
    rng = np.random.default_rng(0)
    best = np.zeros(len(p), dtype=bool)
    for _ in range(128):
        sample = rng.permutation(len(p))[:5]
        fit = umeyama(p[sample], q[sample])
        inliers = np.linalg.norm(fit @ p - q, axis=1) < 0.005
        if inliers.sum() > best.sum():
            best = inliers
    return umeyama(p[best], q[best]).R


def geometry_rows() -> list[tuple[str, Callable[[], object], Callable[[], object]]]:
    rng = np.random.default_rng(0)
    p = rng.uniform(-0.3, 0.3, (10_000, 3))
    q = 0.25 * p @ so3_exp([0.3, 0.2, 0.1]).T + 0.1 + rng.normal(0, 0.001, p.shape)
    q_outliers = q.copy()
    q_outliers[:3000] += 0.1
    camera = Camera(WIDTH, HEIGHT, 912.0, 911.0, 640.0, 355.0, (0.11, -0.23, 7e-4, -1e-3, 0.09))
    image = rng.integers(0, 256, (HEIGHT, WIDTH, 3), dtype=np.uint8)
    camera.rays()

    def rays_again() -> object:
        grid = camera.pixel_grid().reshape(-1, 1, 2)
        return cv2.undistortPoints(grid, camera.K, np.array(camera.distortion))

    return [
        ("umeyama, 10k points", lambda: umeyama(p, q), lambda: umeyama_by_loop(p, q)),
        (
            "ransac_similarity, 10k, 30 % out",
            lambda: ransac_similarity(p, q_outliers, threshold_m=0.005),
            lambda: ransac_of_fixed_length(p, q_outliers),
        ),
        (
            "undistort 1280x720 colour",
            lambda: undistort_image(image, camera),
            lambda: cv2.undistort(image, camera.K, np.array(camera.distortion)),
        ),
        ("rays of a distorted camera", camera.rays, rays_again),
    ]


def main() -> None:
    print(f"{'':34}{'ours ms':>10}{'plain ms':>10}{'ratio':>8}")
    with tempfile.TemporaryDirectory() as folder:
        for name, ours, plain in [*file_rows(Path(folder)), *geometry_rows()]:
            a, b = median_ms(ours), median_ms(plain)
            print(f"{name:34}{a:10.2f}{b:10.2f}{b / a:8.2f}")
    print("files of ours are checked for damage when read, synced and moved in place when written")


if __name__ == "__main__":
    main()
