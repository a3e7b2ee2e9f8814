"""Light of the projector behind solid glass: `python perf/solid_shadow.py [--photons 8000000]`.

The simulator lets a fixed share of the projector's light (`SOLID_SHADOW`) straight through solids,
instead of bending it. This reference bends it: photons leave the projector evenly over the
directions, are refracted and reflected by Mitsuba's own smooth dielectric, and are counted in cells
of 2 mm of the floor. Printed are shares of the light that the floor receives without the object, in
its straight shadow: their mean, their quartiles (caustics hold much of the light in few cells), and
the x. `simulated` is what the simulator has there.
"""

from __future__ import annotations

import argparse
from typing import Any

import numpy as np
import pandas as pd
import trimesh
from numpy.typing import NDArray

from std_toolkit.geometry.ray_caster import RayCaster

CELL_M, HALF_M = 0.002, 0.3
DEEPEST = 16
HEIGHT_M = 0.6


def solids() -> dict[str, trimesh.Trimesh]:
    """Solids of the sizes of vessels and of the liquids in them, resting on z = 1 mm."""
    lying = trimesh.transformations.rotation_matrix(np.pi / 2, (1, 0, 0))
    found = {
        "ball of 80 mm": trimesh.creation.icosphere(5, 0.04),
        "box of 60 x 60 x 100 mm": trimesh.creation.box((0.06, 0.06, 0.1)),
        "plate of 120 x 120 x 12 mm": trimesh.creation.box((0.12, 0.12, 0.012)),
        "standing cylinder, 60 x 100 mm": trimesh.creation.cylinder(0.03, 0.1, sections=512),
        "lying cylinder, 60 x 160 mm": trimesh.creation.cylinder(0.03, 0.16, sections=512),
    }
    found["lying cylinder, 60 x 160 mm"].apply_transform(lying)
    for mesh in found.values():
        mesh.apply_translation([0, 0, 0.001 - mesh.bounds[0, 2]])
    return found


def irradiance(
    mi: Any, dr: Any, scene: Any, source: NDArray[np.float64], photons: int, seed: int
) -> NDArray[np.float64]:
    """(n, n) photons on cells of the floor, those of a source that lights it from above."""
    n = int(2 * HALF_M / CELL_M)
    counts = np.zeros((n, n))
    batch = 1_000_000
    for start in range(0, photons, batch):
        sampler = mi.load_dict({"type": "independent"})
        sampler.seed(seed + start // batch, batch)
        aim = sampler.next_2d()
        # Evenly over the floor, so that without an object every cell receives the same.
        to = mi.Point3f((2 * aim.x - 1) * HALF_M, (2 * aim.y - 1) * HALF_M, 0)
        origin = mi.Point3f(*(float(v) for v in source))
        ray = mi.Ray3f(origin, dr.normalize(to - origin))
        weight, active = dr.full(mi.Float, 1, batch), dr.full(mi.Bool, True, batch)
        context = mi.BSDFContext(mi.TransportMode.Importance)
        for _ in range(DEEPEST):
            si = scene.ray_intersect(ray, active)
            active &= si.is_valid()
            bsdf = si.bsdf()
            clear = mi.has_flag(bsdf.flags(), mi.BSDFFlags.Delta)
            ends = active & ~clear
            cell = [mi.Int32(dr.floor((v + HALF_M) / CELL_M)) for v in (si.p.x, si.p.y)]
            inside = ends & (cell[0] >= 0) & (cell[0] < n) & (cell[1] >= 0) & (cell[1] < n)
            keep = np.array(inside)
            at = np.array(cell[1])[keep] * n + np.array(cell[0])[keep]
            counts += np.bincount(at, np.array(weight)[keep], n * n).reshape(n, n)
            active &= clear
            sample, value = bsdf.sample(
                context, si, sampler.next_1d(), sampler.next_2d(), active & clear
            )
            weight = weight * dr.select(active, value.x, 1)
            ray = si.spawn_ray(si.to_world(sample.wo))
            dr.eval(ray, weight, active)
    return counts


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--photons", type=int, default=8_000_000)
    args = parser.parse_args()
    import drjit as dr
    import mitsuba as mi

    from sensors.render.variant import choose_variant

    mi.set_variant(choose_variant())
    from sensors.render.glass import SOLID_SHADOW, THICK_SHARE

    rows = {}
    floor = {"type": "rectangle", "bsdf": {"type": "diffuse"}}
    for name, mesh in solids().items():
        for ior in (1.33, 1.5):
            for elevation in (45, 75):
                parts = {"floor": floor, "solid": solid(mi, mesh, ior)}
                scene = mi.load_dict({"type": "scene", **parts})
                away = np.deg2rad(elevation)
                source = HEIGHT_M * np.array([np.cos(away), 0.1, np.sin(away)])
                lit = irradiance(mi, dr, scene, source, args.photons, 0)
                n = len(lit)
                share = lit / (args.photons / n**2)
                thick = 2 * mesh.volume / mesh.area > THICK_SHARE * mesh.scale
                two_faces = (1 - ((ior - 1) / (ior + 1)) ** 2) ** 2
                rows[f"{name}, n = {ior}, {elevation} deg"] = {
                    **of_shadow(mesh, source, share),
                    "simulated": two_faces * (SOLID_SHADOW if thick else 1),
                    "solid": thick,
                }
    table = pd.DataFrame(rows).T.astype(float)
    means = table.groupby("solid").mean().rename(index={0: "mean of thin ones", 1: "of solids"})
    table = pd.concat([table.drop(columns="solid"), means])
    print(table.to_string(float_format="%.2f"))


def solid(mi: Any, mesh: trimesh.Trimesh, ior: float) -> Any:
    """The mesh as a smooth dielectric, with the normals of its faces where they meet sharply."""
    properties = mi.Properties()
    properties["bsdf"] = mi.load_dict({"type": "dielectric", "int_ior": ior})
    made = mi.Mesh("solid", len(mesh.vertices), len(mesh.faces), props=properties)
    parameters = mi.traverse(made)
    parameters["vertex_positions"] = mi.Float(np.ravel(mesh.vertices).astype(np.float32))
    parameters["faces"] = mi.UInt32(np.ravel(mesh.faces).astype(np.uint32))
    parameters.update()
    return made


def of_shadow(
    mesh: trimesh.Trimesh, source: NDArray[np.float64], share: NDArray[np.float64]
) -> dict[str, float]:
    """Statistics of the cells that the object hides from the source."""
    n = len(share)
    at = (np.arange(n) + 0.5) * CELL_M - HALF_M
    x, y = np.meshgrid(at, at)
    points = np.stack([x, y, np.zeros_like(x)], axis=-1)
    rays = np.concatenate([points, source - points], axis=-1).astype(np.float32)
    hidden = np.isfinite(RayCaster(mesh.vertices, mesh.faces).cast(rays).distance)
    under = (abs(x) < mesh.bounds[1, 0]) & (abs(y) < mesh.bounds[1, 1])
    behind = share[hidden & ~under]
    quartiles = np.quantile(share[hidden], [0.25, 0.5, 0.75])
    return {
        "mean": share[hidden].mean(),
        **dict(zip(("25 %", "median", "75 %"), quartiles, strict=True)),
        "beside the foot: mean": behind.mean(),
        "median beside it": float(np.median(behind)),
    }


if __name__ == "__main__":
    main()
