"""kill -9 at random moments of a run loses only what was being written.

`make test` kills 4 times; STD_KILLS=50 does it 50 times, as before a release.
"""

from __future__ import annotations

import json
import os
import random
import re
import shutil
import signal
import subprocess
import sys
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from scene_on_disk import contents

from sensors.synthetic import (
    RecordingOptions,
    annotate_first_frame,
    make_recording,
)
from std_toolkit.cli.main import main
from std_toolkit.geometry.mesh import load_mesh
from std_toolkit.jobs import JobOptions

pytestmark = [pytest.mark.slow, pytest.mark.timeout(3600)]
KILLS = int(os.environ.get("STD_KILLS", "4"))
# With a seed and one thread the mapper repeats itself exactly, so poses can be compared as bytes.
OPTIONS = ("--seed", "1", "--threads", "1", "--renderer", "raycast", "--workers", "2")


@dataclass(frozen=True)
class Reference:
    """A labelled scene before the run, what an undisturbed run makes of it, and its seconds."""

    labelled: Path
    finished: Path
    seconds: float


def start(scene: Path) -> subprocess.Popen[str]:
    return subprocess.Popen(
        [sys.executable, "-m", "std_toolkit.cli.main", "--quiet", "run", str(scene), *OPTIONS],
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        start_new_session=True,
    )


def finish(process: subprocess.Popen[str]) -> str:
    output, _ = process.communicate(timeout=1200)
    return output


@pytest.fixture(scope="module")
def reference(tmp_path_factory: pytest.TempPathFactory) -> Reference:
    folder = tmp_path_factory.mktemp("kill")
    recording, labelled = folder / "recording", folder / "labelled"
    options = RecordingOptions(frames=12, arc_degrees=33, width=320, height=240)
    truth = make_recording(recording, options, jobs=JobOptions(progress=False))
    arguments = ["--color", recording / "color", "--depth", recording / "depth"]
    arguments += ["--intrinsics", recording / "intrinsics.json", "--out", labelled]
    assert main(["--quiet", "import", *map(str, arguments)]) == 0
    extents = {o.name: float(max(load_mesh(recording / o.mesh).extents)) for o in truth.objects}
    annotated = annotate_first_frame(truth, extents_m=extents)
    for item in truth.objects[:2]:
        pose = folder / f"{item.name}.txt"
        np.savetxt(pose, annotated[item.name].matrix(), fmt="%.9f")
        arguments = ["--object", item.name, "--mesh", recording / item.mesh]
        arguments += ["--material", item.material, "--frame", 0, "--pose", pose]
        assert main(["--quiet", "label", str(labelled), *map(str, arguments)]) == 0

    finished = Path(shutil.copytree(labelled, folder / "finished"))
    began = time.monotonic()
    process = start(finished)
    output = finish(process)
    assert process.returncode in (0, 1), output  # a gate may fail on so small a scene
    assert (finished / "check/report.html").exists(), output
    return Reference(labelled, finished, time.monotonic() - began)


def finished_files(scene: Path) -> dict[str, int]:
    """Modification times of the files of finished steps and frames, by their records."""
    names: set[str] = set()
    for record in [*scene.glob(".std/records/*.json"), *scene.glob("gt/info/*.json")]:
        names |= {record.relative_to(scene).as_posix(), *json.loads(record.read_text())["outputs"]}
    return {name: (scene / name).stat().st_mtime_ns for name in sorted(names)}


def products(scene: Path) -> dict[str, bytes]:
    """All that a run makes, but for intermediate files of the steps and the time of a judgement."""
    work = (".std/poses/", ".std/work/")
    found = {k: v for k, v in contents(scene).items() if not k.startswith(work)}
    found["labels.json"] = re.sub(rb'"time": "[^"]*"', b"", (scene / "labels.json").read_bytes())
    return found


def leftovers(scene: Path) -> list[str]:
    return [p.name for p in scene.rglob("*") if ".tmp" in p.name or ".partial" in p.name]


def test_a_second_run_does_nothing(reference: Reference) -> None:
    before = {p: p.stat().st_mtime_ns for p in reference.finished.rglob("*") if p.is_file()}
    output = finish(start(reference.finished))
    after = {p: p.stat().st_mtime_ns for p in reference.finished.rglob("*") if p.is_file()}
    changed = [str(p) for p in after if p.name != "lock" and before.get(p) != after[p]]
    assert not changed, output


def test_killed_runs_end_as_an_undisturbed_one(reference: Reference, tmp_path: Path) -> None:
    moments = random.Random(int(os.environ.get("STD_KILL_SEED", "0")))
    kills = chains = 0
    expected = products(reference.finished)
    while kills < KILLS:
        chains += 1
        scene = Path(shutil.copytree(reference.labelled, tmp_path / f"scene_{chains}"))
        reach = 0.35
        while True:
            kept = finished_files(scene)
            # A write takes a millisecond and is rarely hit, so each kill also gets a leftover.
            folders = [scene, *(p for p in scene.rglob("*") if p.is_dir())]
            (moments.choice(folders) / f".map.{kills:012x}.tmp.png").write_bytes(b"torn")
            process = start(scene)
            killed = False
            try:
                wanted = kills < KILLS
                moment = moments.uniform(0.02, reach) * reference.seconds
                output, _ = process.communicate(timeout=moment if wanted else 1200)
            except subprocess.TimeoutExpired:
                os.kill(process.pid, signal.SIGKILL)
                output, _ = process.communicate(timeout=60)
                killed = True
                kills += 1
                reach = min(reach * 1.15, 1.5)  # a run that is always killed early never ends
            now = finished_files(scene)
            redone = [name for name, when in kept.items() if now.get(name) != when]
            assert not redone, f"finished, yet redone after kill {kills}: {redone}\n{output}"
            if not killed:
                break
        assert leftovers(scene) == [], f"chain {chains}, {kills} kills"
        made = products(scene)
        assert sorted(made) == sorted(expected), f"chain {chains}: {output}"
        different = [name for name in expected if made[name] != expected[name]]
        assert not different, f"chain {chains}: {different}"
        shutil.rmtree(scene)
    print(f"{kills} kills in {chains} scenes")
