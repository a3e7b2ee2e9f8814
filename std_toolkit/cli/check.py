"""`std-curate check`: are the labels right? A report with pictures, numbers and gates."""

from __future__ import annotations

import argparse
from dataclasses import fields
from pathlib import Path

from std_toolkit.checks.options import CheckOptions
from std_toolkit.cli.command_line import add_job_arguments, job_options

_LIMITS = {
    "min_registered": "smallest share of frames with a camera pose",
    "max_reprojection_px": "largest mean reprojection error of the camera poses",
    "max_scale_disagreement": "largest relative difference between two sources of metres",
    "max_edge_px": "largest median distance of a contour to the nearest image edge",
    "max_shift_px": "largest median shift between a contour and the image",
    "max_depth_mm": "largest median depth residual on a diffuse object, beyond the scale's part",
    "max_drift_px": "largest movement of the image against a label that no pose explains",
    "max_label_std_mm": "largest standard deviation of a label",
    "min_edge_support": "smallest share of a contour that must meet image edges to be judged",
}
_WORK = {
    "max_frames": "frames to look at, evenly spread; 0 = all",
    "overlay_frames": "frames shown with all labels; 0 = no pictures",
    "search_px": "how far from a contour to look for an edge",
    "shift_px": "largest shift of a whole contour to try",
    "image_width": "largest width of the pictures",
    "jpeg_quality": "of the pictures, 1 to 100",
}


def add_parser(subparsers: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    parser = subparsers.add_parser(
        "check",
        help="judge the labels: report with pictures and numbers, gates",
        description="Measure the labels of a scene against its images and depth and write "
        "check/report.html, report.json, report.csv and frames.csv. Exit status 1 if a gate fails.",
    )
    parser.add_argument("scene", type=Path, metavar="SCENE")
    _add_options(parser.add_argument_group("limits of the gates"), _LIMITS)
    _add_options(parser.add_argument_group("amount of work"), _WORK)
    add_job_arguments(parser)
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    from std_toolkit.checks.check_step import report_path, run_check
    from std_toolkit.scene import Scene

    options = CheckOptions(**{name: getattr(args, name) for name in (*_LIMITS, *_WORK)})
    scene = Scene.open(args.scene)
    report = run_check(scene, options, job_options(args))
    for gate in report.failed_gates():
        unit = f" {gate.unit}" if gate.unit else ""
        about = f" ({gate.detail})" if gate.detail else ""
        print(
            f"FAIL {gate.key}: {gate.title}: {gate.value:.4g}{unit}{about}, must be {gate.rule} "
            f"{gate.limit:g}{unit}; {gate.advice}"
        )
    for warning in report.warnings:
        # Failed gates are told above; what is of low weight is in the report.
        if warning.severity != "low" and not warning.gate:
            print(f"warning: {warning.about}: {warning.problem}; {warning.advice}")
    print(report.verdict)
    print(f"report: {report_path(scene.root)}")
    return 0 if report.passed else 1


def _add_options(group: argparse._ArgumentGroup, texts: dict[str, str]) -> None:
    for field in fields(CheckOptions):
        if field.name in texts:
            group.add_argument(
                f"--{field.name.replace('_', '-')}",
                type=type(field.default),
                default=field.default,
                metavar="N",
                help=f"{texts[field.name]} (default: {field.default:g})",
            )
