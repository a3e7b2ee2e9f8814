"""Nothing leaves the machine: every command of every program, with an empty home folder.

One process runs all of them; what looks an address up or connects is told
and refused, and so is a new file in the home folder that the docs do not state. A command without a
row here fails.
"""

from __future__ import annotations

import json
import re
from pathlib import Path

import numpy as np
import pytest
import trimesh

from std_toolkit.cli.programs import PROGRAMS
from std_toolkit.cli.programs import _load as program_of
from std_toolkit.io.images import write_color, write_depth_png16
from tests.dreds_on_disk import write_dreds_scene
from tests.scene_on_disk import write_scene
from tests.std_toolkit.test_libraries import alone

SPLIT = "--data data --split dreds-catknown-test"
REC = "--color rec/color --depth rec/depth --intrinsics rec/intrinsics.json"
DFNET = "--method dfnet --set input_size=32,32 channels=8 layers=1"
# Words of each command, as small as it does its work with, and its status. Words that begin with
# what the command lacks are refused after its libraries are imported.
ROWS: dict[str, dict[str, tuple[str, int]]] = {
    "std-curate": {
        "import": (f"{REC} --out scene", 0),
        "doctor": (REC, 0),
        "info": ("a", 0),
        "poses": ("a", 1),
        "trajectory": ("a --out t.csv", 0),
        "label": ("a --object box_1 --pose pose.txt --frame 0", 0),
        "carry": ("b --from a", 1),
        "propagate": ("a", 0),
        "render": ("a --engine serial", 0),
        "check": ("a --engine serial", 1),
        "export": ("a --format bop --out bop --engine serial --allow-wrong", 0),
        "run": ("b --engine serial", 1),
        "project create": ("p --scenes a --people me", 0),
        "project add": ("p --people you", 0),
        "project people": ("p --token you", 0),
        "project status": ("p", 0),
        "project run": ("p --engine serial", 0),
        "project review": ("p a --by me --send-back turned", 0),
        "project agreement": ("p", 1),
        "project export": ("p --format bop --out set --licence MIT", 1),
        "schema": ("scene", 0),
        "settings": ("checks.gates", 0),
    },
    "std-annotate": {
        "open": ("a --script edits.json", 0),
        "compare": ("c d", 0),
        "merge": ("c d --out merged", 0),
    },
    "std-bench": {
        "depth": (f"--method nearest {SPLIT} --out bd --engine serial", 0),
        "pose": (f"--method gt-nocs {SPLIT} --out bp --engine serial", 0),
        "grasp": ("--meshes rec --out bg --engine serial", 1),
        "bop": ("--data rec --results pose.txt", 1),
        "audit": ("bop --out audit --engine serial", 0),
        "bakeoff": ("a --out bake --no-at-hand --no-speed --limit 1", 0),
        "list": ("methods", 0),
        "check-data": ("data --split dreds-catknown-test", 0),
        "infer-list": (f"{SPLIT} --out il --engine serial", 0),
        "order": ("--data rec", 1),
        "self-test": ("--networks shipped", 0),
        "speed": ("--method dfnet --preset compact --repeats 1", 0),
        "verify": ("bd", 0),
        "priors": (
            "--how barycentre --instances 1 --points 64 --categories bottle --out p.safetensors",
            0,
        ),
    },
    "std-record": {"record": ("--list", 0)},
    "std-report": {"report": ("bd", 0), "site": ("bd --out site", 0)},
    "std-restore": {
        "restore": ("rec --out restored --engine serial", 0),
        "live": ("--camera camera.py:One --method nearest --preview p.jpg --frames 1", 0),
        "export": ("--onnx x.onnx --method nearest", 1),
    },
    "std-scan": {
        "photos": ("rec/color --intrinsics 60,60,31.5,23.5 --out scan", 1),
        "board": ("--out board.pdf", 0),
    },
    "std-sim": {
        "run": ("--out sim --scenes 1 --assets folder --assets-root rec --engine serial", 1),
        "preview": ("--out p.png --assets folder --assets-root rec", 1),
        "turntable": ("--mesh box.ply --out tt --views 3 --width 96 --height 64", 0),
        "assets": ("list", 0),
        "stats": ("data", 0),
    },
    "std-train": {
        "pack": ("pk --split dreds-catknown-train --data data --size 32 32 --engine serial", 0),
        "pack-grasps": ("pg --scenes 1 --gripper none --engine serial", 1),
        "train": (
            f"--out tr {DFNET} --data pk --steps 1 --batch-size 1 --accelerator cpu --hold-out 0.5 "
            "--readers 0",
            0,
        ),
        "export": ("tr --out weights", 0),
        "mine": ("--meshes rec --out mine", 1),
        "recipe": ("main-comparison --plan --scale tiny --out recipes", 0),
    },
}
CAMERA = """
import numpy as np
from std_toolkit.cameras import LiveFrame
from std_toolkit.geometry.camera import Camera

class One:
    name = "one"

    def __init__(self, request):
        self.camera = Camera(64, 48, 60, 60, 31.5, 23.5)

    def frames(self):
        for i in range(100):
            depth = np.full((48, 64), 0.7, np.float32)
            yield LiveFrame(np.full((48, 64, 3), i, np.uint8), depth, i)

    def close(self):
        pass
"""
# Runs all rows in one process, which imports each library once.
DRIVER = """
import json, sys, time
from std_toolkit.cli.programs import run
for program, name, words in json.loads(sys.argv[1]):
    before = time.process_time()
    try:
        status = run(program, words)
    except SystemExit as end:
        status = end.code
    seconds = time.process_time() - before
    print(f"STATUS {program} {name} {status} {seconds:.1f} s", file=sys.stderr, flush=True)
"""


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with small inputs of every kind, where the commands run."""
    root = tmp_path_factory.mktemp("place")
    rng = np.random.default_rng(0)
    for n in range(2):
        color = rng.integers(0, 255, (48, 64, 3)).astype(np.uint8)
        write_color(root / f"rec/color/{n}.png", color)
        write_depth_png16(root / f"rec/depth/{n}.png", np.full((48, 64), 0.7), scale=0.001)
    K = '{"width": 64, "height": 48, "fx": 60, "fy": 60, "cx": 31.5, "cy": 23.5}'
    (root / "rec/intrinsics.json").write_text(K)
    for name in "abcd":
        write_scene(root / name)
    for i, part in enumerate(("test/00000", "train/00000", "train/00001")):
        write_dreds_scene(root / "data/DREDS-CatKnown" / part, seed=i)
    pose = np.eye(4)
    pose[2, 3] = 0.6
    np.savetxt(root / "pose.txt", pose)
    (root / "edits.json").write_text("[]")
    (root / "camera.py").write_text(CAMERA)
    trimesh.creation.box((0.05, 0.06, 0.07)).export(root / "box.ply")
    return root


def test_every_command_has_a_row() -> None:
    table = {name: [c.name for c in program_of(name).commands] for name in PROGRAMS}
    assert {name: sorted(rows) for name, rows in ROWS.items()} == {
        name: sorted(commands) for name, commands in table.items()
    }


@pytest.mark.slow
def test_every_command_asks_nobody_and_leaves_nothing(
    place: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(place)
    rows = [
        (program, command, [*([command] if len(table) > 1 else []), *words.split()])
        for program, table in ROWS.items()
        for command, (words, _) in table.items()
    ]
    done, left = alone(tmp_path, ["-c", DRIVER, json.dumps(rows)], seconds=3600)
    found = dict(re.findall(r"^STATUS (.+) (\S+) [\d.]+ s$", done.stderr, re.MULTILINE))
    wanted = {f"{p} {c}": str(status) for p, t in ROWS.items() for c, (_, status) in t.items()}
    assert found == wanted, done.stderr
    assert "OUT:" not in done.stderr
    assert "defect" not in done.stderr
    assert left == []
