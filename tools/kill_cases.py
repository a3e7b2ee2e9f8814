"""Commands that `kills.py` kills, on small inputs that it makes."""

from __future__ import annotations

import hashlib
import json
import shutil
import subprocess
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

RECORDING = ("--frames", "12", "--size", "320", "240", "--arc", "33")


@dataclass(frozen=True)
class Case:
    """A command on prepared inputs.

    Attributes:
        words: the command, given the folder to write to.
        begin: puts what the command begins with into that folder.
        products: parts of paths that are compared; empty for all files.
        leave_out: parts of paths that differ between two undisturbed runs.
        last: the command that ends the work of one that runs until it is stopped.
        without: keys of JSON files that differ between two undisturbed runs.
        geometry: compare the triangles of meshes; of all other files, the names.
    """

    words: Callable[[Path], list[str]]
    begin: Callable[[Path], None] = lambda out: None  # noqa: ARG005
    products: tuple[str, ...] = ()
    leave_out: tuple[str, ...] = ()
    last: Callable[[Path], list[str]] | None = None
    without: tuple[str, ...] = ()
    geometry: bool = False

    def contents(self, out: Path) -> dict[str, str]:
        found = {}
        for path in sorted(p for p in out.rglob("*") if p.is_file()):
            name = path.relative_to(out).as_posix()
            chosen = not self.products or any(part in name for part in self.products)
            if chosen and not any(part in name for part in self.leave_out):
                content = path.read_bytes()
                if self.geometry:
                    content = _triangles(path) if path.suffix in (".glb", ".obj", ".ply") else b""
                if self.without and path.suffix == ".json":
                    content = json.dumps(_without(json.loads(content), self.without)).encode()
                found[name] = hashlib.sha256(content).hexdigest()
        return found


def _triangles(path: Path) -> bytes:
    """Corners of a mesh's faces; a seam of the texture, which doubles vertices, changes none."""
    import numpy as np
    import trimesh

    try:
        mesh = trimesh.load(path, force="mesh", process=False)
    except Exception as error:  # damaged
        return str(error).encode()
    return np.asarray(mesh.triangles, np.float32).tobytes()


def _without(value: Any, keys: tuple[str, ...]) -> Any:
    """A JSON value without these keys, at any depth."""
    if isinstance(value, dict):
        return {k: _without(v, keys) for k, v in value.items() if k not in keys}
    return [_without(v, keys) for v in value] if isinstance(value, list) else value


def program(name: str, *words: object) -> list[str]:
    """Command line of a console script of this tree."""
    return [sys.executable, "-m", "std_toolkit.cli.programs", name, *map(str, words)]


def run(words: list[str]) -> None:
    """Run a command to its end; a failed gate is no error."""
    done = subprocess.run(words, capture_output=True, text=True)
    if done.returncode not in (0, 1) or "error:" in done.stderr:
        sys.exit(f"{' '.join(words)}\n{done.stdout}{done.stderr}")


def cases(top: Path, names: list[str]) -> dict[str, Case]:
    """The commands of these names, with their inputs."""
    makers = {
        ("import", "export", "curate", "bench", "restore"): _scenes,
        ("sim",): _sim,
        ("scan",): _scan,
        ("pack", "train"): _train,
        ("mine",): _mine,
        ("annotate", "web", "window"): _annotate,
    }
    unknown = set(names) - {name for group in makers for name in group}
    if unknown:
        sys.exit(f"no such command: {', '.join(sorted(unknown))}")
    found: dict[str, Case] = {}
    for group, make in makers.items():
        if not names or set(names) & set(group):
            found.update(make(top))
    return {name: found[name] for name in names or found}


def _scenes(top: Path) -> dict[str, Case]:
    """The commands on a synthetic recording and its labelled scene."""
    recording, labelled, solved = top / "recording", top / "labelled", top / "data" / "solved"
    if not (recording / "truth.json").exists():
        run([sys.executable, "-m", "sensors.synthetic", "record", str(recording), *RECORDING])
    if not labelled.exists():
        _label(recording, labelled)
    options = ("--seed", 1, "--threads", 1, "--renderer", "raycast", "--workers", 2)
    if not solved.exists():
        solved.parent.mkdir(exist_ok=True)
        shutil.copytree(labelled, solved)
        run(program("std-curate", "--quiet", "run", solved, *options))
    cameras = top / "known-cameras.json"
    if not cameras.exists():
        _write_cameras(recording, cameras)
    images = ("--color", recording / "color", "--depth", recording / "depth")
    images = (*images, "--intrinsics", recording / "intrinsics.json")
    known = ("--cameras", cameras, "--cameras-unit", "m")
    bench = ("--data", top / "data", "--split", "scenes", "--no-speed", "--workers", 2)
    return {
        "import": Case(
            lambda out: _once(
                out / "scene",
                program("std-curate", "--quiet", "import", *images, *known, "--out", out / "scene"),
            ),
            leave_out=(".std/",),
            without=("time", "created"),
        ),
        "export": Case(
            lambda out: _once(
                out / "bop",
                program(
                    "std-curate", "--quiet", "export", solved, "--format", "bop", "--allow-wrong",
                    "--out", out / "bop",
                ),
            ),
            leave_out=(".std/",),
            without=("time", "created"),
        ),
        "curate": Case(
            lambda out: program("std-curate", "--quiet", "run", out, *options),
            lambda out: shutil.copytree(labelled, out, dirs_exist_ok=True),  # type: ignore[arg-type, return-value]
            leave_out=(".std/poses/", ".std/work/", ".std/lock"),
            without=("time",),
        ),
        "bench": Case(
            lambda out: program(
                "std-bench", "depth", "--method", "raw", "nearest", "planes", *bench,
                "--out", out,
            ),
            leave_out=(".std/", ".devices/", ".digests.json"),  # the last is a cache
        ),
        "restore": Case(
            lambda out: program(
                "std-restore", solved, "--out", out, "--method", "planes", "--workers", 2
            ),
            products=("depth/", "confidence/", "changed/"),
        ),
    }  # fmt: skip


def _once(made: Path, words: list[str]) -> list[str]:
    """The command, or nothing where a run before was finished: it takes no folder with content."""
    return [sys.executable, "-c", ""] if made.exists() else words


def _write_cameras(recording: Path, path: Path) -> None:
    """The true camera poses of a synthetic recording, as `--cameras` reads them."""
    from sensors.synthetic import read_truth

    names = sorted(p.name for p in (recording / "color").iterdir())
    poses = dict(zip(names, map(list, read_truth(recording).T_world_cam), strict=True))
    path.write_text(json.dumps(poses))


def _sim(top: Path) -> dict[str, Case]:
    """Two scenes of two objects, one view each."""
    shapes = top / "shapes"
    if not shapes.exists():
        import trimesh

        for name, mesh in (
            ("box", trimesh.creation.box((0.1, 0.06, 0.08))),
            ("ball", trimesh.creation.icosphere(3, 0.05)),
        ):
            (shapes / name).mkdir(parents=True)
            mesh.export(shapes / name / "model.obj")
    tiny = ("--preset", "tiny", "--width", 96, "--height", 54, "--views", 1)
    return {
        "sim": Case(
            lambda out: program(
                "std-sim", "--out", out, "--assets", "folder", "--assets-root",
                shapes, *tiny, "--scenes", 2, "--engine", "serial",
            ),
            products=("DREDS-CatKnown/",),
        ),
    }  # fmt: skip


def _scan(top: Path) -> dict[str, Case]:
    """A painted ball in 16 photos of 160x120 with known cameras."""
    from tests.std_toolkit.scanning.test_scan_step import write_photos

    if not (top / "cameras.json").exists():
        shutil.rmtree(top / "photos", ignore_errors=True)
        write_photos(top / "photos")
    small = ("--faces", 2000, "--texture", 128, "--voxels", 60, "--engine", "serial")
    case = Case(
        lambda out: program(
            "std-scan", "photos", top / "photos", "--out", out / "ball",
            "--intrinsics", "260,260,79.5,59.5", "--cameras", top / "cameras.json", *small,
        ),
        products=(".obj", ".mtl", ".png", ".glb", ".ply"),
        leave_out=(".std/", "work/"),
        geometry=True,
    )  # fmt: skip
    return {"scan": case}


def _train(top: Path) -> dict[str, Case]:
    """A tiny DFNet: the same steps and the same weights."""
    from tests.benchmark.training.training_set import TINY, packed, write_scenes

    pack = top / "pack"
    if not pack.exists():
        packed(pack, write_scenes(top / "dreds"))
    case = Case(
        lambda out: program(
            "std-train", "--method", "dfnet", "--data", pack, "--steps", 20,
            "--set", *(f"{name}={value}" for name, value in TINY["dfnet"].items()),
            "--batch-size", 4, "--hold-out", 0.3, "--checkpoint-every", 2, "--validate-every", 10,
            "--readers", 1, "--accelerator", "cpu", "--out", out / "run",
        ),
        products=("last.safetensors", "best.safetensors", "best.json"),
    )  # fmt: skip
    split = ("--split", "dreds-catknown-train", "--data", top / "dreds")
    packing = Case(
        lambda out: program(
            "std-train", "pack", out / "pack", *split, "--size", 32, 32, "--shard", 2,
            "--workers", 2,
        ),
        products=(".npy", ".json"),
        leave_out=(".std/",),
    )  # fmt: skip
    return {"pack": packing, "train": case}


def _mine(top: Path) -> dict[str, Case]:
    """`std-train mine` on three labelled scenes of two frames: links, a pack, weights, scores."""
    import numpy as np

    from std_toolkit import RenderOptions, render_ground_truth
    from std_toolkit.io.images import write_color
    from tests.scene_on_disk import write_scene

    scenes, written = top / "mine", top / "mine-scenes"
    if not scenes.exists():
        shutil.rmtree(written, ignore_errors=True)
        for i, name in enumerate("abc", 1):
            scene = write_scene(written / name, frames=2)
            for frame in scene.frames:
                write_color(scene.color_path(frame), scene.read_color(frame) // np.uint8(i))
            render_ground_truth(scene, RenderOptions(renderer="raycast")).raise_if_failed()
        written.rename(scenes)
    case = Case(
        lambda out: program(
            "std-train", "mine", "--method", "dfnet", "--scenes", scenes, "--steps", 2,
            "--batch-size", 2, "--readers", 0, "--accelerator", "cpu", "--engine", "serial",
            "--out", out / "mine",
        ),
        products=("training/best.", "training/last.safetensors", "images.parquet", "packs/"),
        leave_out=(".std/", "pack.json"),  # which names the folder
    )  # fmt: skip
    return {"mine": case}


def _annotate(top: Path) -> dict[str, Case]:
    """A script of edits and saves; a window and a web server with edits that were not saved."""
    from std_toolkit.scene import Scene
    from tests.scene_on_disk import write_scene

    scene, edited = top / "annotated", top / "edited"
    words = "std-annotate", "open"
    options = ("--annotator", "kills", "--recover", "yes")
    if not edited.exists():
        shutil.rmtree(scene, ignore_errors=True)
        write_scene(scene)
        label = Scene.open(scene).labels.of(1)
        assert label is not None
        poses = [list(label.T_cam_obj) for _ in range(60)]
        for k, pose in enumerate(poses):
            pose[3] += 1e-4 * k
        edits: list[dict[str, Any]] = []
        for k, pose in enumerate(poses):
            change = {"object": "box_1", "frame": 0, "T_cam_obj": pose}
            edits += [{"edit": "set_poses", "changes": [change]}]
            edits += [{"edit": "save"}] * (k % 3 == 2)
        (top / "edits.json").write_text(json.dumps(edits))
        (top / "some.json").write_text(json.dumps([e for e in edits if e["edit"] != "save"][:20]))
        (top / "save.json").write_text(json.dumps([{"edit": "save"}]))
        shutil.copytree(scene, edited)
        run(program(*words, edited, "--script", top / "some.json", *options))

    def saved(out: Path) -> list[str]:
        return program(*words, out, "--script", top / "save.json", *options)

    kept: dict[str, Any] = {
        "products": ("labels.json", "objects.json", "poses.json", "frames.json", "scene.json"),
        "leave_out": (".std/",),
        "without": ("provenance", "updated"),
    }
    started: dict[str, Any] = {
        **kept, "begin": lambda out: shutil.copytree(edited, out, dirs_exist_ok=True), "last": saved
    }  # fmt: skip
    return {
        "annotate": Case(
            lambda out: program(*words, out, "--script", top / "edits.json", *options),
            lambda out: shutil.copytree(scene, out, dirs_exist_ok=True),  # type: ignore[arg-type, return-value]
            **kept,
        ),
        "web": Case(lambda out: program(*words, out, "--web", 0, *options), **started),
        "window": Case(lambda out: program(*words, out, *options), **started),
    }


def _label(recording: Path, labelled: Path) -> None:
    import numpy as np

    from sensors.synthetic import annotate_first_frame, read_truth
    from std_toolkit.geometry.mesh import load_mesh

    curate = "std-curate"
    run(
        program(
            curate, "--quiet", "import", "--color", recording / "color", "--depth",
            recording / "depth", "--intrinsics", recording / "intrinsics.json", "--out", labelled,
        )
    )  # fmt: skip
    truth = read_truth(recording)
    extents = {o.name: float(max(load_mesh(recording / o.mesh).extents)) for o in truth.objects}
    annotated = annotate_first_frame(truth, extents_m=extents)
    for item in truth.objects[:2]:
        pose = recording / f"{item.name}.txt"
        np.savetxt(pose, annotated[item.name].matrix(), fmt="%.9f")
        run(
            program(
                curate, "--quiet", "label", labelled, "--object", item.name, "--mesh",
                recording / item.mesh, "--material", item.material, "--frame", 0, "--pose", pose,
            )
        )  # fmt: skip
