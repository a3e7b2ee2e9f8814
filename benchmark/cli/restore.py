"""`std-restore`: restore the depth of your camera, export networks to ONNX."""

from __future__ import annotations

import sys
from typing import TYPE_CHECKING

from benchmark.cli import commands, report_failures
from std_toolkit.cli.command import Program, print_json

if TYPE_CHECKING:
    from benchmark.restoring.options import ExportOptions, LiveOptions, RestoreOptions

_COMMANDS = ("restore", "live", "export")


def name_command(words: list[str]) -> list[str]:
    """The command line with its command, which may be left out before a recording.

    >>> name_command(["mugs", "--out", "restored"])
    ['restore', 'mugs', '--out', 'restored']
    >>> name_command(["export", "--onnx", "net.onnx"])
    ['export', '--onnx', 'net.onnx']
    >>> name_command(["--live", "--web", "8080"])
    ['live', '--web', '8080']
    """
    if "--live" in words:
        words = ["live", *(word for word in words if word != "--live")]
    first = next((word for word in words if word not in ("--quiet", "--debug")), "--help")
    if first in _COMMANDS or first in ("-h", "--help", "--version", "--print-completion"):
        return words
    return ["restore", *words]


def restore(options: RestoreOptions) -> int:
    """Restore recordings; returns the exit status."""
    from benchmark.restoring.run import restore_recordings

    report = restore_recordings(options)
    if options.json:
        print_json(report.records())
    else:
        print("\n".join(report.lines()))
    return report_failures(report.failed)


def live(options: LiveOptions) -> None:
    """Restore the depth of a connected camera."""
    from benchmark.restoring.live import restore_live

    report = restore_live(options)
    rate = report.restored / report.seconds if report.seconds > 0 else 0.0
    print(f"{report.camera}: {report.restored} of {report.received} frames, {rate:.1f} a second")
    if options.out is not None:
        print(f"camera's images: {options.out / 'recording'}; restored: {options.out}")


def export(options: ExportOptions) -> None:
    """Write a network as ONNX."""
    from benchmark.restoring.onnx_export import export_choice

    print(export_choice(options))


PROGRAM = Program(
    name="std-restore",
    about="Restore the depth of recordings at the camera's own size. What is restored already is\n"
    "kept: run the same command again to resume.",
    commands=commands(
        "benchmark.cli.restore",
        "benchmark.restoring.options",
        ("restore", "restore recordings or images", "RestoreOptions", "restore"),
        ("live", "restore the depth of a connected camera", "LiveOptions", "live"),
        ("export", "write a network as an ONNX file", "ExportOptions", "export"),
    ),
    default="restore",
    rewrite=name_command,
)
main = PROGRAM.main

if __name__ == "__main__":
    sys.exit(main())
