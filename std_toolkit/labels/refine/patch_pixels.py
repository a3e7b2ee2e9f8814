"""Rays, normals and outlines of rendered patches, pixel by pixel in compiled code.

A refinement casts thousands of patches of an object. Arrays of directions and conditions over all
pixels cost as much time as the rays, and outlines are a few percent of the pixels.

Patches are (N, h, w). Rays are cast without the margin of the patch, so that arrays of rays and
normals are smaller by twice the margin.
"""

from __future__ import annotations

import numpy as np

from std_toolkit.compiled import compiled

# Binomial smoothing of Sobel's operator, and its difference, after a box of 3 pixels.
_SMOOTH = np.array([1, 3, 4, 3, 1], np.float32)
_CHANGE = np.array([-1, -1, 0, 1, 1], np.float32)
_CHANNELS = 5
_LARGEST_RELIEF = 6.0


@compiled
def fill_rays(eye, R, x, y, rays):  # type: ignore[no-untyped-def]
    """Write rays (N, h, w, 6) in the object frame.

    Args:
        eye: (N, 3) float32 origins.
        R: (N, 3, 3) float32 rotations of the object in the camera frame.
        x, y: (N, w) and (N, h) float32 directions in the camera frame, z = 1.
        rays: to write to.
    """
    for n in range(len(R)):
        for r in range(y.shape[1]):
            for c in range(x.shape[1]):
                for k in range(3):
                    rays[n, r, c, k] = eye[n, k]
                    down = y[n, r] * R[n, 1, k] + R[n, 2, k]
                    rays[n, r, c, 3 + k] = x[n, c] * R[n, 0, k] + down


@compiled
def facing_normals(normal, rays, R):  # type: ignore[no-untyped-def]
    """(3, h, w) float32 normals towards the camera, in the world.

    Args:
        normal: (h, w, 3) float32 of either sign, object frame.
        rays: (h, w, 6) float32, object frame.
        R: (3, 3) float32 rotation of the object in the world.
    """
    height, width, _ = normal.shape
    found = np.empty((3, height, width), np.float32)
    for r in range(height):
        for c in range(width):
            x, y, z = normal[r, c, 0], normal[r, c, 1], normal[r, c, 2]
            away = x * rays[r, c, 3] + y * rays[r, c, 4] + z * rays[r, c, 5]
            sign = np.float32(-1) if away > 0 else np.float32(1)
            for k in range(3):
                found[k, r, c] = sign * (R[k, 0] * x + R[k, 1] * y + R[k, 2] * z)
    return found


@compiled
def keep_visible(  # type: ignore[no-untyped-def]
    distance, normal, rays, margin, others, row, column, depth
):
    """Write the depth of visible pixels, and turn their normals towards the camera.

    Args:
        distance: (N, h', w') float32 of the rays, inf without a hit.
        normal: (N, h', w', 3) float32, to turn; zero afterwards where nothing is visible.
        rays: (N, h', w', 6).
        margin: pixels of a patch around its rays.
        others: (H, W) z-depth of other objects in the window, inf = none.
        row, column: (N, h) and (N, w) of the patches in the window.
        depth: (N, h, w) zeros, to write to.
    """
    for n in range(distance.shape[0]):
        for r in range(distance.shape[1]):
            for c in range(distance.shape[2]):
                d = distance[n, r, c]
                if not d < others[row[n, r + margin], column[n, c + margin]]:
                    for k in range(3):
                        normal[n, r, c, k] = 0
                    continue
                depth[n, r + margin, c + margin] = d
                away = np.float32(0)
                for k in range(3):
                    away += normal[n, r, c, k] * rays[n, r, c, 3 + k]
                if away > 0:
                    for k in range(3):
                        normal[n, r, c, k] = -normal[n, r, c, k]


@compiled
def outline_weights(  # type: ignore[no-untyped-def]
    depth, normal, margin, others, row, column, jump, crease_cosine, crease_weight
):
    """(N, h, w) weight of the outline at each pixel: both pixels beside it have it.

    Args:
        depth: (N, h, w), 0 where the object is not visible.
        normal, margin, others, row, column: see `keep_visible`.
        jump: difference in depth of an outline within the object, metres.
        crease_cosine: of the angle between normals at a crease, which has `crease_weight`.
    """
    count, height, width = depth.shape
    weight = np.zeros(depth.shape, np.float32)
    for n in range(count):
        for r in range(height):
            for c in range(width):
                a = depth[n, r, c]
                for down in range(2):
                    s, e = r + down, c + 1 - down
                    if s >= height or e >= width:
                        continue
                    b = depth[n, s, e]
                    value = np.float32(0)
                    if a > 0 and b > 0:
                        if abs(b - a) > jump:
                            value = np.float32(1)
                        else:
                            i, j = r - margin, c - margin
                            k, m = s - margin, e - margin
                            cosine = np.float32(0)
                            for q in range(3):
                                cosine += normal[n, i, j, q] * normal[n, k, m, q]
                            if cosine < crease_cosine:
                                value = np.float32(crease_weight)
                    # A border with a nearer surface does not belong to the object.
                    elif a > 0:
                        if others[row[n, s], column[n, e]] > a:
                            value = np.float32(1)
                    elif b > 0 and others[row[n, r], column[n, c]] > b:
                        value = np.float32(1)
                    weight[n, r, c] = max(weight[n, r, c], value)
                    weight[n, s, e] = max(weight[n, s, e], value)
    return weight


@compiled
def outline_angles(depth, normal, margin, distance, jump, at):  # type: ignore[no-untyped-def]
    """(P,) direction of what changes at flat pixels (P,): mask, depth in jumps, or normal.

    Angles are in [0, pi). All channels are combined (Di Zenzo's structure tensor).

    Args:
        depth, normal, margin: see `outline_weights`.
        distance: depth that counts as level, metres.
        jump: metres of depth that count as one.
        at: (P,) at least two pixels within the patch.
    """
    _, height, width = depth.shape
    angle = np.empty(len(at), np.float32)
    smooth = np.empty((_CHANNELS, 5), np.float32)
    change = np.empty((_CHANNELS, 5), np.float32)
    value = np.zeros(_CHANNELS, np.float32)
    for p in range(len(at)):
        n, rest = divmod(at[p], height * width)
        r, c = divmod(rest, width)
        smooth[:] = 0
        change[:] = 0
        for i in range(5):
            for j in range(5):
                d = depth[n, r + i - 2, c + j - 2]
                if not d > 0:
                    continue
                relief = (d - distance) / jump
                value[0] = 2
                value[1] = min(max(relief, -_LARGEST_RELIEF), _LARGEST_RELIEF)
                for k in range(3):
                    value[2 + k] = normal[n, r + i - 2 - margin, c + j - 2 - margin, k]
                for k in range(_CHANNELS):
                    smooth[k, j] += _SMOOTH[i] * value[k]
                    change[k, j] += _CHANGE[i] * value[k]
        xx, xy, yy = np.float32(0), np.float32(0), np.float32(0)
        for k in range(_CHANNELS):
            x, y = np.float32(0), np.float32(0)
            for j in range(5):
                x += _CHANGE[j] * smooth[k, j]
                y += _SMOOTH[j] * change[k, j]
            xx += x * x
            xy += x * y
            yy += y * y
        found = 0.5 * np.arctan2(2 * xy, xx - yy)
        angle[p] = found + np.pi if found < 0 else found
    return angle
