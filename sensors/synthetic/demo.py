"""The demo: a simulated recording through the whole pipeline, with the user's commands."""

import importlib.util
import shlex
import subprocess
import sys
import time
from collections.abc import Mapping
from pathlib import Path

from sensors.output.recording_writer import Truth, read_truth
from sensors.synthetic.recording import RecordingOptions, make_recording
from sensors.synthetic.simulated import SimulatedOptions
from sensors.synthetic.truth import label_errors, write_annotations
from std_toolkit.errors import ToolkitError
from std_toolkit.scene.scene import Scene

# Small enough for two cores and some minutes, long enough for structure from motion.
SIMULATED = SimulatedOptions()
QUICK = RecordingOptions(frames=40, arc_degrees=100.0)
_SIMULATOR = ("coacd", "manifold3d", "mitsuba", "mujoco")


def run_demo(out: Path, *, quick: bool = False, simulated: SimulatedOptions = SIMULATED) -> int:
    """Record, import, label, run, export, score; completed steps are kept.

    If the simulator is not installed, or would be too slow, the quick recording is used, in a
    separate folder.

    Args:
        out: folder for everything.
        quick: use the quick recording in any case.
        simulated: the simulated recording.

    Returns:
        Exit status of the first command that failed, or 0.
    """
    started = time.monotonic()
    if not quick and not (out / "recording" / "truth.json").exists():
        missing = why_no_simulator()
        if missing is not None:
            print(f"note: {missing}; the demo takes the quick recording, not the simulator's")
            quick = True
    if quick:
        out = out / "quick"
    recording, scene = out / "recording", out / "scene"
    if quick:
        _say(f"Recording {QUICK.frames} synthetic frames to {recording}")
        truth = make_recording(recording, QUICK)
    else:
        _say(f"Simulating {simulated.frames} frames of an active stereo camera to {recording}")
        # A separate process, which frees its memory for the steps that follow.
        status = _python("sensors.synthetic", _record_arguments(recording, simulated))
        if status:
            return status
        truth = read_truth(recording)
    poses = write_annotations(truth, recording)
    _say("An annotator's first-frame poses (1 px, 1 degree off the truth) lie beside it.")

    commands = pipeline(truth, recording, scene, poses)
    if quick:
        # The quick sensor reads 1.5 % too far, which only objects of known size can correct. The
        # simulated one is calibrated without error: its scale is better than an estimate from six
        # small objects.
        commands[-1] += " --refine-scale"
    commands.append(f"export {scene} --format bop --out {out}/bop")
    commands.append(f"export {scene} --format std --out {out}/std")
    for command in commands:
        status = curate(command)
        if status:
            return status

    _say("Label error against the exact truth (MSSD over all frames, symmetry aware)")
    print(label_errors(Scene.open(scene), recording).table())
    _say(f"Done in {time.monotonic() - started:.0f} s")
    print(f"report:     {scene / 'check' / 'report.html'}")
    print(f"BOP export: {out / 'bop'}")
    print(f"STD export: {out / 'std'}")
    return 0


def pipeline(
    truth: Truth,
    recording: Path,
    scene: Path,
    poses: Mapping[str, Path],
    meshes: Mapping[str, Path] | None = None,
) -> list[str]:
    """Arguments of std-curate from a recording to checked labels, one command each.

    Args:
        truth: of the recording.
        recording: its folder.
        scene: folder of the scene; an imported one is kept.
        poses: first-frame pose of every object, of `write_annotations`.
        meshes: mesh of every object in the frame of the recording's (default: the recording's).
    """
    commands = []
    if not (scene / "scene.json").exists():
        commands.append(
            f"import --color {recording}/color --depth {recording}/depth --depth-scale 0.001 "
            f"--intrinsics {recording}/intrinsics.json --out {scene}"
        )
    for item in truth.objects:
        symmetry = "axis:y" if item.symmetry.continuous else "none"
        mesh = recording / item.mesh if meshes is None else meshes[item.name]
        commands.append(
            f"label {scene} --object {item.name} --mesh {mesh} "
            f"--category {item.category} --material {item.material} --symmetry {symmetry} "
            f"--frame 0 --pose {poses[item.name]} --annotator demo"
        )
    return [*commands, f"run {scene}"]


def why_no_simulator() -> str | None:
    """Reason why the simulator cannot make the recording here in minutes, or None."""
    absent = [name for name in _SIMULATOR if importlib.util.find_spec(name) is None]
    if absent:
        return f"the simulator is not installed ({', '.join(absent)}; pip install '.[sim]')"
    from sensors.render.variant import SLOW_VARIANT, choose_variant

    try:
        variant = choose_variant()
    except ToolkitError as error:
        return error.problem
    if variant == SLOW_VARIANT:
        return "rendering is slow here without libllvm19 (tools/system-libraries simulator)"
    return None


def _record_arguments(recording: Path, options: SimulatedOptions) -> str:
    return (
        f"record {recording} --simulated --frames {options.frames} --arc {options.sweep_deg:g} "
        f"--size {options.width} {options.height} --quality {options.quality} "
        f"--seed {options.seed}"
    )


def curate(arguments: str) -> int:
    """Run one command of std-curate, and return its exit status."""
    print(f"\n$ std-curate {arguments}", flush=True)
    return _run("std_toolkit.cli.main", arguments)


def _python(module: str, arguments: str) -> int:
    print(f"\n$ python -m {module} {arguments}", flush=True)
    return _run(module, arguments)


def _run(module: str, arguments: str) -> int:
    command = [sys.executable, "-m", module, *shlex.split(arguments)]
    return subprocess.run(command, check=False).returncode


def _say(text: str) -> None:
    print(f"\n== {text}", flush=True)
