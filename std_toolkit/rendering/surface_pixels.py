"""NOCS and normals of the visible pixels of an object, pixel by pixel in compiled code.

A frame has some 100,000 pixels of objects, and in numpy each intermediate array of them costs as
much time as its sums.
"""

import numpy as np

from std_toolkit.compiled import compiled


@compiled
def fill_maps(  # type: ignore[no-untyped-def]
    index, wanted, depth, face, x, y, R, origin, table, face_normals, closed, scale, nocs, normals
):
    """Write NOCS and unit normals, towards the camera, of the visible pixels of one object.

    Args:
        index, depth, face: (h,w) of the composition inside the object's window.
        wanted: position of the object in `index`.
        x, y: (h,w) float64 rays, z = 1.
        R, origin: rotation of the object and position of its centre in the camera frame.
        table: (F,17) `RenderMesh.interpolation`; empty for the normals of the triangles.
        face_normals: (F,3) float32.
        closed: whether no triangle is seen from behind.
        scale: 1 / diagonal.
        nocs, normals: (h,w,3) float32, to write to.
    """
    smooth = len(table) > 0
    one = np.float32(1)
    turn = R.astype(np.float32)
    scale = np.float32(scale)
    n = np.zeros(3, np.float32)
    local = np.zeros(3, np.float32)
    for row in range(index.shape[0]):
        for column in range(index.shape[1]):
            if index[row, column] != wanted:
                continue
            # In float64, because centred coordinates are small compared with the distance.
            z = np.float64(depth[row, column])
            px = x[row, column] * z - origin[0]
            py = y[row, column] * z - origin[1]
            pz = z - origin[2]
            for k in range(3):
                local[k] = px * R[0, k] + py * R[1, k] + pz * R[2, k]
                nocs[row, column, k] = local[k] * scale + np.float32(0.5)
            f = face[row, column]
            if smooth:
                t = table[f]
                v = t[0] * local[0] + t[1] * local[1] + t[2] * local[2] + t[3]
                w = t[4] * local[0] + t[5] * local[1] + t[6] * local[2] + t[7]
                # Rounding of the depth may put the point just outside its triangle.
                v = min(max(v, np.float32(0)), one)
                w = min(max(w, np.float32(0)), one)
                for k in range(3):
                    n[k] = t[8 + k] + v * t[11 + k] + w * t[14 + k]
                length = np.sqrt(n[0] * n[0] + n[1] * n[1] + n[2] * n[2])
                inverse = one / max(length, np.float32(1e-12))
                for k in range(3):
                    n[k] *= inverse
            else:
                for k in range(3):
                    n[k] = face_normals[f, k]
            if not closed:
                # Its dot product with the sight line, in the camera frame turned to the mesh's.
                sight = np.float64(0)
                for k in range(3):
                    ray = (px + origin[0]) * R[0, k] + (py + origin[1]) * R[1, k] + z * R[2, k]
                    sight += face_normals[f, k] * ray
                if sight > 0:
                    for k in range(3):
                        n[k] = -n[k]
            for k in range(3):
                normals[row, column, k] = n[0] * turn[k, 0] + n[1] * turn[k, 1] + n[2] * turn[k, 2]
