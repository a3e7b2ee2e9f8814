"""Labels with scanned meshes against labels with the true ones: `python perf/scan_labels.py`.

    python perf/scan_labels.py [--work DIR] [--size 800 450] [--views 48] [--threads N]

The demo's recording of six objects is labelled twice from the same first-frame poses: with the true
meshes, and with meshes that `std-scan` makes of path-traced photos of each object (`std-sim
turntable`), poses and masks not given. Diffuse objects are photographed in the colours that they
have in the recording, the steel bowl sprayed, the glass bottle as it is with `--revolve`; the walls
of mug and bowl are measured (`--wall-mm`). A scanned mesh is moved rigidly onto the true one, from
the true cameras on, so that both have the frame of the first-frame poses. Prints how far each mesh
is from the true one, and the label errors (MSSD of the true mesh over all frames) of both. Finished
steps in DIR are kept.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from pathlib import Path

import numpy as np
import trimesh

REPOSITORY = Path(__file__).resolve().parent.parent
sys.path[:0] = [str(REPOSITORY), str(REPOSITORY / "perf")]

from scan import by_cameras, compare  # noqa: E402

from sensors.materials.textures import to_linear, to_srgb  # noqa: E402
from sensors.output.recording_writer import TrueObject, read_truth  # noqa: E402
from sensors.simulation.options import TurntableOptions  # noqa: E402
from sensors.simulation.turntable import make_turntable  # noqa: E402
from sensors.synthetic.demo import curate, pipeline, run_demo  # noqa: E402
from sensors.synthetic.simulated import SimulatedOptions, draw_objects  # noqa: E402
from sensors.synthetic.truth import label_errors, write_annotations  # noqa: E402
from std_toolkit.geometry.mesh import load_mesh  # noqa: E402
from std_toolkit.importers.foreign_files import write_mesh  # noqa: E402
from std_toolkit.jobs import JobOptions  # noqa: E402
from std_toolkit.scanning.model.write_model import write_model  # noqa: E402
from std_toolkit.scanning.options import ScanOptions  # noqa: E402
from std_toolkit.scanning.scan_step import scan  # noqa: E402
from std_toolkit.scene.scene import Scene  # noqa: E402

# Thickness of the walls of open vessels at the rim, as calipers measure it.
WALLS_MM = {"mug_3": 3.4, "bowl_2": 3.2}
# What does not stand flat is photographed from below, too.
TURNED_OVER = ("car_6",)


def colored_meshes(work: Path) -> dict[str, Path]:
    """The objects of the demo's recording with the colours that it shows."""
    out = {}
    for asset, drawn in zip(*draw_objects(SimulatedOptions().seed), strict=True):
        mesh, share = asset.scaled(drawn.diagonal_m), drawn.material.own_share
        own = asset.face_colors if asset.face_colors is not None else np.full((1, 3), 188, np.uint8)
        mixed = share * to_linear(own) + (1 - share) * np.asarray(drawn.material.color)
        colors = np.resize(to_srgb(mixed), (len(mesh.faces), 3))
        mesh = trimesh.Trimesh(mesh.vertices, mesh.faces, face_colors=colors, process=False)
        name = f"{drawn.category}_{drawn.instance}"
        out[name] = work / "colored" / f"{name}.ply"
        write_mesh(out[name], mesh)
    return out


def scanned_mesh(item: TrueObject, mesh: Path, work: Path, args: argparse.Namespace) -> Path:
    """Mesh of a scan of the object in the frame of its true mesh."""
    name, photos = item.name, work / "turntables" / item.name
    glass = item.material == "transparent"
    made = work / "models" / name / f"{name}.obj"
    if made.exists():
        return made
    over = photos.with_name(f"{photos.name}_flipped")
    turned = name in TURNED_OVER
    for out in (photos, over)[: 1 + turned]:
        make_turntable(
            TurntableOptions(
                mesh=mesh, out=out, up="y", views=args.views, flipped=out == over,
                width=args.size[0], height=args.size[1],
                material="glass" if glass else "sprayed" if item.material == "specular" else "own",
            )
        )  # fmt: skip
    done = scan(
        ScanOptions(
            photos=photos / "photos", board=photos / "board.json", out=work / "scans" / name,
            flipped=over / "photos" if turned else None,
            revolve=glass, wall_mm=WALLS_MM.get(name), jobs=JobOptions(workers=args.threads),
        )
    )  # fmt: skip
    truth, start = load_mesh(photos / "truth" / "mesh.ply"), by_cameras(done, photos)
    row, T = compare(done, truth, start)
    print(f"{name:24} {'  '.join(f'{k} {v:.2f}' for k, v in row.items())}", flush=True)
    moved = done.vertices @ T[:3, :3].T + T[:3, 3]
    return write_model(made.parent, name, moved, done.faces, done.texture)["obj"]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--work", type=Path)
    parser.add_argument("--size", type=int, nargs=2, default=(800, 450))
    parser.add_argument("--views", type=int, default=48)
    parser.add_argument("--threads", type=int, default=2)
    args = parser.parse_args()
    work = args.work or Path(tempfile.mkdtemp(prefix="scan-labels-"))
    demo = work / "demo"
    if run_demo(demo):
        raise SystemExit("the demo failed")
    recording, scene = demo / "recording", work / "scene"
    truth = read_truth(recording)
    colored = colored_meshes(work)
    meshes = {o.name: scanned_mesh(o, colored[o.name], work, args) for o in truth.objects}
    for command in pipeline(truth, recording, scene, write_annotations(truth, recording), meshes):
        # Labels that the checks of `run` reject are compared, too.
        if curate(command) and not command.startswith("run "):
            raise SystemExit(f"std-curate {command} failed")
    both = [label_errors(Scene.open(s), recording) for s in (demo / "scene", scene)]
    print(f"{'object':<14}{'material':<13}{'true mesh':>10}{'scanned':>10}{'worse by':>10}  mm")
    for item in truth.objects:
        middle = [1000 * float(np.median(errors.mssd_m[item.name])) for errors in both]
        print(
            f"{item.name:<14}{item.material:<13}{middle[0]:>10.2f}{middle[1]:>10.2f}"
            f"{middle[1] - middle[0]:>10.2f}"
        )
    middle = [errors.percentile_mm(50) for errors in both]
    print(f"{'all':<27}{middle[0]:>10.2f}{middle[1]:>10.2f}{middle[1] - middle[0]:>10.2f}")


if __name__ == "__main__":
    main()
