"""Depth from surface normals, occlusion boundaries and what the sensor measured elsewhere.

The last step of ClearGrasp (Sajjan et al., ICRA 2020), which took it from Zhang and Funkhouser:
Deep depth completion of a single RGB-D image, CVPR 2018. Minimised over the depth D of all pixels:

    sum over observed p        (w_o (D_p - measured_p))^2
    + sum over neighbours p, q (w_s (D_p - D_q))^2
    + sum over neighbours p, q (w_n f b_p N_p . (D_q r_q - D_p r_p))^2

where r are the rays at z = 1 of the pixels, f the focal length, N_p the normal at p and b_p a
weight that is low where an occlusion boundary is likely. The weights are factors of the residuals,
as in the authors' program, where the papers' formulas have them before the squares; q are the four
neighbours of p, and both (p, q) and (q, p) count. The difference of the two points is not
normalised (the factor f makes up for its length on average), so the problem is linear and sparse.
"""

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csc_matrix

from benchmark.methods.depth.filling.colorization import factorized
from std_toolkit.errors import ToolkitError
from std_toolkit.geometry.camera import Camera, pixel_rays

Array = NDArray[np.float64]
LARGEST_LENGTH_ERROR = 0.05  # of a unit normal; float16 and interpolation stay below it


@dataclass(frozen=True, kw_only=True)
class OptimizationOptions:
    """Weights and limits; the defaults are the published ones.

    Attributes:
        observed_weight: of keeping a measurement.
        smoothness_weight: of equal depth of neighbours; settles what normals leave open.
        normal_weight: of the normals.
        boundary_power: a boundary of probability P weighs the normal by (1 - P)^power.
        least_boundary_weight: the least of that weight, so that an object with a boundary all
            around and no measurement inside still hangs on its surroundings.
        nearest_m: measurements nearer than that are dropped.
        grow_px: by how many pixels the mask is widened before its measurements are dropped.

    Raises:
        ToolkitError: a weight that is negative or not finite; smoothness 0, which would leave
            pixels without a normal undetermined.
    """

    observed_weight: float = 1000.0
    smoothness_weight: float = 0.001
    normal_weight: float = 1.0
    boundary_power: float = 3.0
    least_boundary_weight: float = 0.001
    nearest_m: float = 0.1
    grow_px: int = 2

    def __post_init__(self) -> None:
        for name in ("observed_weight", "smoothness_weight"):
            value = getattr(self, name)
            if not (0 < value < np.inf):
                raise ToolkitError("must be positive", field=name, value=value)
        for name in ("normal_weight", "boundary_power", "least_boundary_weight", "nearest_m"):
            value = getattr(self, name)
            if not (0 <= value < np.inf):
                raise ToolkitError("must not be negative", field=name, value=value)
        if self.grow_px < 0:
            raise ToolkitError("must not be negative", field="grow_px", value=self.grow_px)


def optimize_depth(
    depth: NDArray[np.floating],
    normals: NDArray[np.floating],
    boundary: NDArray[np.floating] | None,
    mask: NDArray[np.bool_] | None,
    camera: Camera,
    options: OptimizationOptions | None = None,
) -> NDArray[np.float32]:
    """Depth that agrees with the measurements outside a mask and with the normals everywhere.

    Args:
        depth: (h, w) metres; 0, negative or not finite where nothing was measured.
        normals: (h, w, 3) unit normals in the OpenCV camera frame (x right, y down, z forward),
            towards the camera: a wall that faces it has (0, 0, -1). ClearGrasp's files and
            networks have y up and z towards the camera: see `normals_to_opencv`. Where a normal is
            not of length 1 (ClearGrasp's files have (-1, -1, -1) where they know none), not finite,
            or points away from the camera, it counts for nothing.
        boundary: (h, w) probability in [0, 1] that an occlusion boundary runs through the pixel;
            None for no boundaries.
        mask: (h, w) bool pixels (of transparent objects) whose measurements are wrong; None drops
            no measurement.
        camera: intrinsics at this size.
        options: weights.

    Returns:
        (h, w) float32 metres, of every pixel. Measured pixels move, too, by what their weight
        allows (micrometres). 0 everywhere where no measurement is left; a pixel whose solution is
        not positive is 0 as well.

    Raises:
        ToolkitError: sizes that do not fit, or a boundary outside [0, 1].
    """
    options = options or OptimizationOptions()
    _check(depth, normals, boundary, mask, camera)
    observed = np.isfinite(depth) & (depth > 0) & (depth >= options.nearest_m)
    if mask is not None:
        observed &= ~_grown(mask, options.grow_px)
    if not observed.any():
        return np.zeros(depth.shape, dtype=np.float32)
    measured = np.where(observed, depth, 0.0).astype(np.float64)
    # In units of the mean depth, so that rounding does not depend on the unit.
    unit = float(measured[observed].mean())
    weight = options.normal_weight * camera.fx * _boundary_weight(boundary, depth.shape, options)
    matrix = _normal_equations(normals, weight, observed, camera, options)
    right = (options.observed_weight**2 / unit) * measured.ravel()
    solve = factorized(matrix, np.ones_like(observed))
    solution = solve(right)
    # One step of iterative refinement: the weights span six orders of magnitude, their squares
    # twelve.
    solution += solve(right - matrix @ solution)
    found = (unit * solution).reshape(depth.shape)
    return np.where(np.isfinite(found) & (found > 0), found, 0).astype(np.float32)


def normals_to_opencv(normals: NDArray[np.floating]) -> NDArray[np.floating]:
    """(..., 3) normals with y up and z towards the camera (ClearGrasp, OpenGL) in OpenCV's frame.

    The same function goes back.
    """
    return normals * np.array([1, -1, -1], dtype=normals.dtype)


def _normal_equations(
    normals: NDArray[np.floating],
    weight: Array,
    observed: NDArray[np.bool_],
    camera: Camera,
    options: OptimizationOptions,
) -> csc_matrix:
    """A^T A of all residuals. Every residual but the observed ones concerns two neighbours."""
    rays = np.nan_to_num(pixel_rays(camera))
    normal = np.asarray(normals, dtype=np.float64)
    normal = np.where(np.isfinite(normal), normal, 0.0)
    usable = np.abs(np.linalg.norm(normal, axis=-1) - 1) < LARGEST_LENGTH_ERROR
    # The angle to the line of sight decides, not z: at a wide view the two differ.
    usable &= (normal * rays).sum(axis=-1) < 0
    normal = np.where(usable[..., None], normal, 0.0)
    number = np.arange(observed.size).reshape(observed.shape)
    diagonal = np.where(observed, options.observed_weight**2, 0.0)
    smooth = 2 * options.smoothness_weight**2  # both (p, q) and (q, p)
    rows, columns, entries = [], [], []
    for p, q in (
        (np.s_[:, :-1], np.s_[:, 1:]),
        (np.s_[:-1], np.s_[1:]),
    ):
        cross = np.full(number[p].shape, -smooth)
        diagonal[p] += smooth
        diagonal[q] += smooth
        for at in (p, q):  # the normal of either end
            to_p = weight[at] * (normal[at] * rays[p]).sum(axis=-1)
            to_q = weight[at] * (normal[at] * rays[q]).sum(axis=-1)
            diagonal[p] += to_p**2
            diagonal[q] += to_q**2
            cross -= to_p * to_q
        rows += [number[p].ravel(), number[q].ravel()]
        columns += [number[q].ravel(), number[p].ravel()]
        entries += [cross.ravel()] * 2
    rows.append(number.ravel())
    columns.append(number.ravel())
    entries.append(diagonal.ravel())
    return csc_matrix(
        (np.concatenate(entries), (np.concatenate(rows), np.concatenate(columns))),
        shape=(observed.size, observed.size),
    )


def _boundary_weight(
    boundary: NDArray[np.floating] | None, shape: tuple[int, ...], options: OptimizationOptions
) -> Array:
    if boundary is None:
        return np.ones(shape)
    weight = (1 - np.asarray(boundary, dtype=np.float64)) ** options.boundary_power
    return np.maximum(weight, options.least_boundary_weight)


def _grown(mask: NDArray[np.bool_], reach: int) -> NDArray[np.bool_]:
    if not reach:
        return mask
    square = np.ones((2 * reach + 1, 2 * reach + 1), np.uint8)
    return cv2.dilate(mask.astype(np.uint8), square).astype(bool)


def _check(
    depth: NDArray[np.floating],
    normals: NDArray[np.floating],
    boundary: NDArray[np.floating] | None,
    mask: NDArray[np.bool_] | None,
    camera: Camera,
) -> None:
    size = (camera.height, camera.width)
    shapes = {"depth": (depth.shape, size), "normals": (normals.shape, (*size, 3))}
    if boundary is not None:
        shapes["boundary"] = (boundary.shape, size)
    if mask is not None:
        shapes["mask"] = (mask.shape, size)
    for name, (shape, wanted) in shapes.items():
        if shape != wanted:
            raise ToolkitError(
                f"does not fit the camera's {camera.width}x{camera.height}: expected {wanted}",
                field=name,
                value=shape,
            )
    # Written so that NaN fails.
    if boundary is not None and not ((boundary >= 0) & (boundary <= 1)).all():
        raise ToolkitError("must hold probabilities in [0, 1]", field="boundary")
