"""What `tools/try-wheel` does with an installed wheel: `python try_wheel.py BIN`.

It makes a synthetic recording and takes it from import to export, scores and restores depth, and
asks for what only extras can do. It runs in a folder whose own packages `benchmark`, `sensors` and
`annotator` fail when they are imported, with `PYTHONPATH=.`.
"""

from __future__ import annotations

import json
import os
import shlex
import subprocess
import sys
import tempfile
from pathlib import Path

import cv2
import numpy as np

METHOD = """
import numpy as np
from benchmark.methods.protocol import Restored

class FromBehind:
    input_size, needs_mask = None, False

    def __init__(self, options):
        pass

    def restore(self, views):
        return [Restored(np.where(v.depth > 0, v.depth, v.depth.max())) for v in views]
"""
PROGRAMS = ("annotate", "bench", "curate", "record", "report", "restore", "scan", "sim", "train")
FRAMES = 20
# std_toolkit first, which puts its packages before those of the folder.
SYNTHETIC = (
    "python -c 'import std_toolkit, sensors.synthetic.__main__ as m; raise SystemExit(m.main())'"
)
RECORD = f"{SYNTHETIC} record camera --frames {FRAMES} --arc 60 --size 480 360"
MADE = {
    "scenes/table/check/report.html": 1,
    "std/**/*.exr": 2 * FRAMES,
    "bop/**/depth/*.png": FRAMES,
    "page/report.html": 1,
    "restored/depth/*.png": FRAMES,
}
MEDIAN_MM = 3.0
# Without extras: what is missing is named with the command that installs it.
MISSING = (
    ("std-restore rec --intrinsics 96,96,47.5,35.5 --out o1", "std-toolkit[restore]"),
    ("std-restore scene --method nlspn --out o3", "std-toolkit[train]"),
    ("std-restore scene --method nearest --out o7 --engine ray", "std-toolkit[cluster]"),
    ("std-annotate scene", "std-toolkit[gui]"),
    ("std-annotate scene --web 0", "std-toolkit[web]"),
    ("std-record rec2 --list", "std-toolkit[realsense]"),
    ("std-sim --out o4 --scenes 1", "std-toolkit[sim]"),
    ("std-scan photos rec/color --out o8", "std-toolkit[scan]"),
    ("std-train --method swindrnet --data o2 --out o5", "std-toolkit[train]"),
    ("std-curate import rec.mcap --out o6", "std-toolkit[ros]"),
)


def curation(folder: Path) -> list[str]:
    """Command lines that take the recording of a camera from its import to scores."""
    truth = json.loads((folder / "camera" / "truth.json").read_text())
    labels = [
        f"std-curate label scenes/table --object {item['name']} --mesh camera/{item['mesh']}"
        f" --category {item['category']} --material {item['material']} --frame 0"
        f" --symmetry {'axis:y' if item['symmetry']['continuous'] else 'none'}"
        f" --pose camera/annotation/{item['name']}.txt --annotator wheel"
        for item in truth["objects"]
    ]
    return [
        "std-curate import --color camera/color --depth camera/depth --depth-scale 0.001"
        " --intrinsics camera/intrinsics.json --out scenes/table",
        "std-curate poses scenes/table",
        *labels,
        "std-curate propagate scenes/table --refine --refine-scale",
        "std-curate render scenes/table",
        "std-curate check scenes/table",
        *(f"std-curate export scenes/table --format {f} --out {f}" for f in ("std", "bop", "nocs")),
        "std-bench --method raw nearest telea --data scenes --split scenes --out scores --no-speed",
        "std-report scores --out page",
        "std-restore scenes/table --method nearest --out restored",
    ]


def call(binaries: Path, line: str, folder: Path) -> subprocess.CompletedProcess[str]:
    """Run a command line in the folder."""
    name, *words = shlex.split(line)
    environment = {k: v for k, v in os.environ.items() if k != "PYTHONHOME"} | {"PYTHONPATH": "."}
    return subprocess.run(
        [str(binaries / name), *words],
        cwd=folder,
        env=environment,
        capture_output=True,
        text=True,
        timeout=3600,
        check=False,
    )


def prepare(folder: Path) -> None:
    """A recording, a plug-in, and packages of the user with the toolkit's names."""
    for name in ("benchmark", "sensors", "annotator"):
        (folder / name).mkdir()
        (folder / name / "__init__.py").write_text("raise ImportError('a package of the user')\n")
    (folder / "my_methods.py").write_text(METHOD)
    (folder / "rec.mcap").write_bytes(b"\x89MCAP0\r\n")
    color = np.random.default_rng(0).integers(0, 255, (72, 96, 3), np.uint8)
    depth = np.full((72, 96), 700, np.uint16)
    depth[20:40, 30:60] = 0
    for kind, image in (("color", color), ("depth", depth)):
        (folder / "rec" / kind).mkdir(parents=True, exist_ok=True)
        for i in range(2):
            cv2.imwrite(str(folder / "rec" / kind / f"{i:04d}.png"), image)


def main(binaries: Path) -> int:
    """Try all; returns the number of faults."""
    faults = 0

    def expect(holds: bool, line: str, done: subprocess.CompletedProcess[str]) -> None:
        nonlocal faults
        if not holds:
            faults += 1
            print(f"FAULT {line}: status {done.returncode}")
            print(done.stdout[-800:], done.stderr[-1500:])

    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        prepare(folder)
        for program in PROGRAMS:
            line = f"std-{program} --help"
            done = call(binaries, line, folder)
            expect(done.returncode == 0 and "usage" in done.stdout.lower(), line, done)
        images = "--color rec/color --depth rec/depth --intrinsics 96,96,47.5,35.5"
        good = (
            f"std-curate import {images} --out scene",
            "std-curate info scene",
            "std-restore scene --method nearest --out near",
            f"std-restore {images} --method my_methods.py:FromBehind --workers 2 --out own",
            "std-bench list methods",
        )
        for line in good:
            done = call(binaries, line, folder)
            expect(done.returncode == 0, line, done)
        expect(len(list((folder / "own/depth").glob("*.png"))) == 2, "own/depth has 2 images", done)
        done = call(binaries, RECORD, folder)
        expect(done.returncode == 0, RECORD, done)
        for line in curation(folder):
            done = call(binaries, line, folder)
            expect(done.returncode == 0, line, done)
        for pattern, count in MADE.items():
            found = len(list(folder.glob(pattern)))
            expect(found == count, f"{count} files {pattern}, not {found}", done)
        done = call(binaries, f"{SYNTHETIC} score scenes/table camera", folder)
        # The last row is of all objects: frames, median and 95th percentile of the error in mm.
        median_mm = float((done.stdout.split() or ["inf"] * 2)[-2])
        expect(done.returncode == 0 and median_mm < MEDIAN_MM, f"error of {median_mm} mm", done)
        for line, command in MISSING:
            done = call(binaries, line, folder)
            one_line = "Traceback" not in done.stderr
            expect(done.returncode != 0 and command in done.stderr and one_line, line, done)
    print(f"{faults} faults")
    return faults


if __name__ == "__main__":
    sys.exit(min(main(Path(sys.argv[1])), 1))
