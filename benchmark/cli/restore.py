"""`std-restore`: restore the depth of your camera, export networks to ONNX."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from std_toolkit.cli.command import Command, Program, print_json

if TYPE_CHECKING:
    from benchmark.restoring.options import ExportOptions, LiveOptions, RestoreOptions
    from benchmark.restoring.run import RestoreReport

_COMMANDS = ("restore", "live", "export")


def main(arguments: Sequence[str] | None = None) -> int:
    """Entry point; returns the exit status."""
    return PROGRAM.main(arguments)


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
        print_json(_records(report))
    else:
        for name, out in report.folders.items():
            print(_line(report, name, str(out)))
    for key, error in report.failed.items():
        print(f"error: {key}: {error}", file=sys.stderr)
    return 1 if report.failed else 0


def live(options: LiveOptions) -> None:
    """Restore the depth of a connected camera."""
    from benchmark.restoring.live import restore_live

    report = restore_live(options)
    rate = report.restored / report.seconds if report.seconds > 0 else 0.0
    print(f"{report.camera}: {report.restored} of {report.received} frames, {rate:.1f} a second")
    if options.out is not None:
        print(f"camera's images: {options.out / 'recording'}; restored: {options.out}")


def export(options: ExportOptions) -> int:
    """Write a network as ONNX; returns the exit status."""
    from benchmark.methods.registry import MethodOptions, preset_for
    from benchmark.restoring.onnx_export import export_onnx
    from benchmark.restoring.restorer import settings_of

    choice = options.choice
    settings = settings_of(choice.settings)
    if choice.size is not None:
        settings["input_size"] = f"{choice.size[0]},{choice.size[1]}"
    found = export_onnx(
        choice.method,
        MethodOptions(
            preset=preset_for(choice.method, choice.preset, choice.weights),
            weights=choice.weights,
            settings=settings,
        ),
        options.out,
    )
    told = [f"depth differs from torch's by at most {found['depth']:.1e} m"]
    if "confidence" in found:
        told.append(f"confidence by {found['confidence']:.1e}")
    print(f"{options.out}: {', '.join(told)}")
    return 0


def _line(report: RestoreReport, name: str, out: str) -> str:
    shares = report.shares(name)
    if not shares:
        return f"{out}: no frame restored"
    told = ", ".join(
        f"{100 * shares[key]:.1f} % {key}" for key in ("kept", "filled", "replaced", "empty")
    )
    return f"{out}: {len(report.frames[name])} frames; of the pixels {told}"


def _records(report: RestoreReport) -> list[dict[str, Any]]:
    return [
        {
            "recording": name,
            "out": str(out),
            "frames": len(report.frames[name]),
            "failed": [k for k in report.failed if k.startswith(f"{name}/")],
            **report.shares(name),
        }
        for name, out in report.folders.items()
    ]


def _command(name: str, about: str, options: str, run: Any) -> Command:
    return Command(
        name=name,
        about=about,
        options=f"benchmark.restoring.options:{options}",
        run=f"benchmark.cli.restore:{run.__name__}",
    )


PROGRAM = Program(
    name="std-restore",
    about="Restore the depth of recordings at the camera's own size. What is restored already is\n"
    "kept: run the same command again to resume.",
    commands=(
        _command("restore", "restore recordings or images", "RestoreOptions", restore),
        _command("live", "restore the depth of a connected camera", "LiveOptions", live),
        _command("export", "write a network as an ONNX file", "ExportOptions", export),
    ),
    default="restore",
    rewrite=name_command,
)

if __name__ == "__main__":
    sys.exit(main())
