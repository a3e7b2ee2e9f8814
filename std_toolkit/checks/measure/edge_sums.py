"""Sums over the points of a contour in compiled code: the inner loops of the check.

A frame has some hundred points per object, and numpy spends most of its time on the small arrays
between the steps of a sum.
"""

from __future__ import annotations

import numpy as np

from std_toolkit.compiled import compiled


@compiled
def add_normal_equations(  # type: ignore[no-untyped-def]
    offsets, strengths, clutter, share, jacobian, motion, width, A, b
):
    """Add the normal equations of a motion to the edges that it makes likely.

    Args:
        offsets: (P, K) positions of edges along the normals in px.
        strengths: (P, K) weights of these edges, 0 for no edge.
        clutter: (P,) number of edges per px that belong to nothing.
        share: (P,) number of independent samples that a point stands for.
        jacobian: (P, D) px per unit of motion.
        motion: (D,) at which edges are weighed.
        width: standard deviation of an edge in px.
        A, b: (D, D) and (D,) sums, of which the lower triangle is filled.
    """
    size = jacobian.shape[1]
    scale = 1 / (np.sqrt(2 * np.pi) * width)
    for p in range(len(offsets)):
        moved = 0.0
        for i in range(size):
            moved += jacobian[p, i] * motion[i]
        density, pulled = 0.0, 0.0
        for k in range(offsets.shape[1]):
            error = (offsets[p, k] - moved) / width
            d = strengths[p, k] * np.exp(-0.5 * error * error) * scale
            density += d
            pulled += d * offsets[p, k]
        factor = share[p] / (density + clutter[p]) / (width * width)
        for i in range(size):
            b[i] += jacobian[p, i] * factor * pulled
            for j in range(i + 1):
                A[i, j] += jacobian[p, i] * jacobian[p, j] * factor * density


@compiled
def next_motion(A, b, prior):  # type: ignore[no-untyped-def]
    """(D,) motion that solves normal equations with a prior (D, D)."""
    for i in range(len(b)):
        for j in range(i):
            A[j, i] = A[i, j]
    return np.linalg.solve(A + prior, b)


@compiled
def climb(  # type: ignore[no-untyped-def]
    offsets, strengths, clutter, share, jacobian, prior, motion, widths, steps
):
    """(D,) motion after some steps with each of the widths, from a motion (D,).

    Args:
        offsets, strengths, clutter, share, jacobian: see `add_normal_equations`.
        prior: (D, D) added to the normal equations.
        motion: (D,) to start from.
        widths: (W,) px.
        steps: number of steps with each width.
    """
    size = len(motion)
    for width in widths:
        for _ in range(steps):
            A, b = np.zeros((size, size)), np.zeros(size)
            add_normal_equations(offsets, strengths, clutter, share, jacobian, motion, width, A, b)
            motion = next_motion(A, b, prior)
    return motion


@compiled
def world_rays(rays, R, t):  # type: ignore[no-untyped-def]
    """(N, 6) float32 origins t and directions R @ ray of camera-frame rays (N, 3), z = 1."""
    found = np.empty((len(rays), 6), np.float32)
    for n in range(len(rays)):
        for k in range(3):
            found[n, k] = t[k]
            found[n, 3 + k] = rays[n, 0] * R[k, 0] + rays[n, 1] * R[k, 1] + R[k, 2]
    return found


@compiled
def strength_at_shifts(normals, offsets, strength, dx, dy):  # type: ignore[no-untyped-def]
    """(N,) mean strength under a contour at N shifts, 0 beyond its profiles.

    Args:
        normals: (P, 2) of the contour.
        offsets: (S,) evenly spaced positions on the profiles, px.
        strength: (P, S) on the profiles.
        dx, dy: (N,) shifts, px.
    """
    total = np.zeros(len(dx))
    points, samples = strength.shape
    step = offsets[1] - offsets[0]
    for p in range(points):
        for n in range(len(dx)):
            # Only the component along the normal moves a point off the contour.
            along = normals[p, 0] * dx[n] + normals[p, 1] * dy[n]
            index = (along - offsets[0]) / step
            if index < 0 or index > samples - 1:
                continue
            low = min(int(index), samples - 2)
            left = strength[p, low]
            total[n] += left + (index - low) * (strength[p, low + 1] - left)
    return total / points


@compiled
def likelihood_gain(  # type: ignore[no-untyped-def]
    offsets, strengths, clutter, jacobian, motion, width
):
    """Mean over the points of log(1 + density of edges / density of clutter) after a motion.

    Args:
        offsets, strengths, clutter, jacobian: see `MotionEquations`; no edge is infinite.
        motion: (D,) with D at most the columns of the jacobian.
        width: standard deviation of an edge in px.
    """
    scale = 1 / (np.sqrt(2 * np.pi) * width)
    total = 0.0
    for p in range(len(offsets)):
        moved = 0.0
        for i in range(len(motion)):
            moved += jacobian[p, i] * motion[i]
        density = 0.0
        for k in range(offsets.shape[1]):
            error = (offsets[p, k] - moved) / width
            if -6.0 < error < 6.0:
                density += strengths[p, k] * np.exp(-0.5 * error * error) * scale
        total += np.log(1 + density / clutter[p])
    return total / len(offsets)


@compiled
def strength_on_grid(points, normals, gx, gy, dx, dy, threshold):  # type: ignore[no-untyped-def]
    """(N,) mean saturated slope along the normals of a contour at N shifts.

    Args:
        points, normals: (P, 2) of the contour, in px of the slopes.
        gx, gy: (H, W) slopes of the image.
        dx, dy: (N,) shifts, px.
        threshold: slope that counts half.
    """
    height, width = gx.shape
    total = np.zeros(len(dx))
    for n in range(len(dx)):
        for p in range(len(points)):
            x, y = int(points[p, 0] + dx[n] + 0.5), int(points[p, 1] + dy[n] + 0.5)
            if 0 <= x < width and 0 <= y < height:
                slope = abs(gx[y, x] * normals[p, 0] + gy[y, x] * normals[p, 1])
                total[n] += slope / (slope + threshold)
    return total / len(points)
