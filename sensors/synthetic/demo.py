"""The demo: a synthetic recording through the whole pipeline, with the commands a user types."""

from __future__ import annotations

import shlex
import subprocess
import sys
import time
from pathlib import Path

from sensors.synthetic.annotation import write_annotations
from sensors.synthetic.recording import RecordingOptions, make_recording
from sensors.synthetic.score import label_errors
from std_toolkit.scene.scene import Scene

# Small enough for two cores and two minutes, long enough for structure from motion.
RECORDING = RecordingOptions(frames=40, arc_degrees=100.0)


def run_demo(out: Path) -> int:
    """Record, import, label, run, export, score; what is done already is kept.

    Returns:
        Exit status of the first command that failed, or 0.
    """
    started = time.monotonic()
    recording, scene = out / "recording", out / "scene"
    _say(f"Recording {RECORDING.frames} synthetic frames to {recording}")
    truth = make_recording(recording, RECORDING)
    poses = write_annotations(truth, recording)
    _say("An annotator's first-frame poses (1 px, 1 degree off the truth) lie beside it.")

    commands = []
    if not (scene / "scene.json").exists():
        commands.append(
            f"import --color {recording}/color --depth {recording}/depth --depth-scale 0.001 "
            f"--intrinsics {recording}/intrinsics.json --out {scene}"
        )
    for item in truth.objects:
        symmetry = "axis:y" if item.symmetry.continuous else "none"
        commands.append(
            f"label {scene} --object {item.name} --mesh {recording}/{item.mesh} "
            f"--category {item.category} --material {item.material} --symmetry {symmetry} "
            f"--frame 0 --pose {poses[item.name]} --annotator demo"
        )
    commands.append(f"run {scene} --refine-scale")
    commands.append(f"export {scene} --format bop --out {out}/bop")
    commands.append(f"export {scene} --format std --out {out}/std")
    for command in commands:
        status = _curate(command)
        if status:
            return status

    _say("Label error against the exact truth (MSSD over all frames, symmetry aware)")
    print(label_errors(Scene.open(scene), recording).table())
    _say(f"Done in {time.monotonic() - started:.0f} s")
    print(f"report:     {scene / 'check' / 'report.html'}")
    print(f"BOP export: {out / 'bop'}")
    print(f"STD export: {out / 'std'}")
    return 0


def _curate(arguments: str) -> int:
    print(f"\n$ std-curate {arguments}", flush=True)
    command = [sys.executable, "-m", "std_toolkit.cli.main", *shlex.split(arguments)]
    return subprocess.run(command, check=False).returncode


def _say(text: str) -> None:
    print(f"\n== {text}", flush=True)
