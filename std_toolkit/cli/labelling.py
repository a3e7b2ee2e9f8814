"""Commands of `std-curate` from labels on: label, carry, propagate, render, check, export, run."""

import sys
from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial

from std_toolkit import options
from std_toolkit.cli.command import print_json
from std_toolkit.cli.recording import asked, recover_poses
from std_toolkit.commands import (
    CheckCommand,
    ExportCommand,
    LabelArguments,
    PosesCommand,
    PropagateCommand,
    RenderCommand,
    RunCommand,
)
from std_toolkit.errors import ToolkitError
from std_toolkit.labels.carry.options import CarryCommand

# Failures of these steps end the run, because later steps need their results. A frame that could
# not be rendered does not end it: the check reports missing frames.
ENDS_THE_RUN = ("poses", "propagate")


def label(command: LabelArguments) -> int:
    """Add an object and set its poses."""
    from std_toolkit.io.atomic import sweep_temporaries
    from std_toolkit.labels.entry.label_command import run_label_command
    from std_toolkit.scene.scene import Scene

    files = len(command.poses) + len(command.correspondences)
    if command.poses and command.correspondences:
        raise ToolkitError("give either --pose or --correspondences, not both")
    shared = len(command.poses) == 1 and len(command.frames) > 0
    if files != len(command.frames) and not shared:
        raise ToolkitError(
            "each --frame needs one --pose or --correspondences",
            value=f"{len(command.frames)} frames, {files} files",
        )
    if shared:  # a file of several images (BOP, 6D-PAT) may hold the poses of several frames
        command = replace(command, poses=command.poses * len(command.frames))
    scene = Scene.open(command.scene)
    with scene.lock():
        sweep_temporaries(scene.root)
        for line in run_label_command(scene, command):
            print(line)
    return 0


def carry(command: CarryCommand) -> int:
    """Carry poses over from another scene."""
    from std_toolkit.labels.carry.carry_step import carry_labels, carry_lines
    from std_toolkit.scene.scene import Scene

    scene = Scene.open(command.scene)
    plan = carry_labels(
        scene, Scene.open(command.source), command.options, annotator=command.annotator
    )
    print("\n".join(carry_lines(plan, scene)))
    print(
        f"{len(plan.objects)} poses carried over, without a verdict: run `std-curate propagate "
        "--refine`, then `std-curate check`"
    )
    return 0


def propagate(command: PropagateCommand) -> int:
    """Propagate labels; 1 if an object has no pose."""
    from std_toolkit.labels.propagate import label_lines, propagate_labels
    from std_toolkit.scene.label_verdicts import label_verdicts
    from std_toolkit.scene.scene import Scene

    scene = Scene.open(command.scene)
    labels = propagate_labels(scene, command.options)
    print("\n".join(label_lines(scene, labels)))
    unjudged = sum(v.grade == "unknown" for v in label_verdicts(scene))
    if unjudged:
        print(f"{unjudged} of {len(labels.labels)} labels have no verdict: run `std-curate check`")
    chosen = {scene.objects.object_named(n).id for n in command.options.objects or ()}
    placed = {x.object: x.T_world_obj is not None for x in labels.labels}
    return 0 if all(placed[x] for x in chosen or placed) else 1


def render(command: RenderCommand) -> int:
    """Render and print a summary; 1 if a frame failed."""
    from std_toolkit.rendering.render_step import render_ground_truth
    from std_toolkit.scene.frame_names import frame_title
    from std_toolkit.scene.scene import Scene

    scene = Scene.open(command.scene)
    with scene.lock():
        chosen = None
        if command.frames is not None:
            found = [scene.find_frame(given) for given in command.frames]
            print("\n".join(frame_title(frame) for frame in found))
            chosen = [frame.id for frame in found]
        report = render_ground_truth(scene, command.options, frames=chosen, jobs=command.jobs)
    kept = sum(1 for outcome in report.results.values() if outcome == "kept")
    print(
        f"ground truth: {len(report.results) - kept} frames rendered, {kept} kept, "
        f"{len(report.failed)} failed; in {scene.root / 'gt'}"
    )
    return 1 if report.failed else 0


def check(command: CheckCommand) -> int:
    """Check the labels; 1 if a label or the scene failed."""
    from std_toolkit.checks.check_step import report_path, run_check
    from std_toolkit.checks.judgements import reason_of
    from std_toolkit.scene.scene import Scene

    scene = Scene.open(command.scene)
    report = run_check(scene, command.options, command.jobs)
    if command.json:
        print_json(report)
        return 0 if report.passed else 1
    for gate in report.failed_gates():
        unit = f" {gate.unit}" if gate.unit else ""
        about = f" ({gate.detail})" if gate.detail else ""
        print(
            f"FAIL {gate.key}: {gate.title}: {gate.value:.4g}{unit}{about}, must be {gate.rule} "
            f"{gate.limit:g}{unit}; {gate.advice}"
        )
    for warning in report.warnings:
        # Failed gates are printed above; warnings of low severity are in the report only.
        if warning.severity != "low" and not warning.gate:
            print(f"warning: {warning.about}: {warning.problem}; {warning.advice}")
    if report.detectability is not None:
        from std_toolkit.checks.page.inject_report import detectability_table

        print(detectability_table(report.detectability).terminal(notes=False))
    for item in report.objects:
        if item.is_labelled and item.verdict != "fits":
            print(f"{item.verdict}: {item.name}: {reason_of(item, report)}")
    print(report.verdict)
    print(f"report: {report_path(scene.root)}")
    return 0 if report.passed else 1


def export(command: ExportCommand) -> int:
    """Export the scene."""
    import msgspec

    from std_toolkit.exporters.export_step import export_scene
    from std_toolkit.scene.scene import Scene

    sidecar = export_scene(
        Scene.open(command.scene),
        command.format,
        command.out,
        options=command.options,
        jobs=asked(command.jobs),
    )
    print(
        f"{command.out}: {len(sidecar.frames)} frames, {len(sidecar.models)} models, "
        f"{len(sidecar.files)} files in the layout of {sidecar.layout}"
    )
    bad = [f for f in sidecar.left_out if f.reason.startswith("check: ")]
    if len(sidecar.left_out) > len(bad):
        print(f"skipped {len(sidecar.left_out) - len(bad)} frames without ground truth")
    if bad:
        print(f"left out {len(bad)} bad frames: {', '.join(f.name for f in bad)}")
    if sidecar.left_out_objects:
        names = ", ".join(x.name for x in sidecar.left_out_objects)
        print(f"left out {len(sidecar.left_out_objects)} objects whose label does not fit: {names}")
    if single := sum(len(f.left_out) for f in sidecar.frames):
        print(f"left out objects of single frames, {single} times (field left_out)")
    if not isinstance(sidecar.quality, msgspec.UnsetType):
        gone = {x.object for x in sidecar.left_out_objects}
        for row in sidecar.quality.labels:
            if row.grade != "fits" and row.object not in gone:
                print(f"{row.grade}: {row.name}: {row.reason}")
    if faulty := sum(bool(f.fault or any(o.fault for o in f.objects)) for f in sidecar.frames):
        print(f"{faulty} exported frames have a fault that the check found (field fault)")
    return 0


def run(command: RunCommand) -> int:
    """Run the steps as their own commands do; a failure of poses or propagate ends the run."""
    status = 0
    for name, step in _steps(command):
        print(f"\n== {name}", flush=True)
        outcome = step()
        status = max(status, outcome)
        if outcome and name in ENDS_THE_RUN:
            print(f"stopped: `{name}` failed, see above", file=sys.stderr)
            break
    return status


def _steps(command: RunCommand) -> Iterator[tuple[str, Callable[[], int]]]:
    """The steps, generated lazily, because each depends on the result of the last."""
    from std_toolkit.log import logger
    from std_toolkit.scene.scene import Scene

    scene, jobs = Scene.open(command.scene), command.jobs
    if scene.poses is not None and scene.poses.source != "sfm":
        logger.info("camera poses: imported ones are kept (%s)", scene.poses.source)
    else:
        poses = options.PoseOptions(**vars(command.poses))
        asked_poses = PosesCommand(scene=command.scene, options=poses, jobs=jobs)
        yield "poses", partial(recover_poses, asked_poses)
    if not scene.labels.labels:
        raise ToolkitError(
            "no object is labelled yet",
            path=command.scene,
            hint="camera poses are complete; label objects with `std-curate label`, then run again",
        )
    labels = options.PropagateOptions(refine=command.refine, refine_scale=command.refine_scale)
    yield "propagate", partial(propagate, PropagateCommand(scene=command.scene, options=labels))
    truth = options.RenderOptions(**vars(command.render))
    rendered = RenderCommand(scene=command.scene, options=truth, jobs=jobs)
    yield "render", partial(render, rendered)
    limits = options.CheckOptions(**vars(command.check))
    yield "check", partial(check, CheckCommand(scene=command.scene, options=limits, jobs=jobs))
