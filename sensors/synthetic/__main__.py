"""`python -m sensors.synthetic`: make a synthetic recording, score labels, run the demo."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

from std_toolkit.cli.command import exit_status
from std_toolkit.errors import ToolkitError
from std_toolkit.jobs.interrupt import GRACE_S
from std_toolkit.log import log_to_stderr

if TYPE_CHECKING:
    from sensors.output.recording_writer import Truth


def main() -> int:
    """Parse, call, print. Exit status: 0 done, 1 a failure."""
    parser = argparse.ArgumentParser(prog="python -m sensors.synthetic", description=__doc__)
    commands = parser.add_subparsers(dest="command", required=True, metavar="COMMAND")
    record = commands.add_parser("record", help="write a recording and its truth")
    record.add_argument("out", type=Path, metavar="DIR", help="folder to write")
    record.add_argument(
        "--simulated",
        action="store_true",
        help="path traced, with simulated stereo depth (minutes; needs the extra [sim])",
    )
    record.add_argument("--frames", type=int, metavar="N", help="120, or 36 with --simulated")
    record.add_argument(
        "--arc", type=float, metavar="DEG", help="around the table: 120, or 100 with --simulated"
    )
    record.add_argument(
        "--size", type=int, nargs=2, metavar=("W", "H"), help="640 480, or 640 360 with --simulated"
    )
    record.add_argument("--quality", help="with --simulated: light paths per pixel (rough)")
    record.add_argument("--seed", type=int)
    score = commands.add_parser("score", help="label error of a scene against the truth")
    score.add_argument("scene", type=Path, metavar="SCENE", help="labelled scene folder")
    score.add_argument("recording", type=Path, metavar="DIR", help="what `record` wrote")
    demo = commands.add_parser("demo", help="record, curate, score")
    demo.add_argument("out", type=Path, metavar="DIR", help="folder for everything")
    demo.add_argument("--quick", action="store_true", help="without the simulator, in seconds")
    args = parser.parse_args()
    log_to_stderr()
    return exit_status(lambda: _run(args), program="python -m sensors.synthetic", grace_s=GRACE_S)


def _run(args: argparse.Namespace) -> int:
    if args.command == "record":
        from sensors.synthetic.truth import write_annotations

        truth = _record(args)
        write_annotations(truth, args.out)
        print(
            f"{args.out}: {len(truth.frames)} frames in color/ and depth/ (millimetres), "
            "intrinsics.json,\nmeshes in models/, a pose of each object in frame 0 in annotation/ "
            "(as a person sets\nit: 1 px, 1 degree off), the truth in truth.json"
        )
        return 0
    if args.command == "score":
        from sensors.synthetic.truth import label_errors
        from std_toolkit.scene.scene import Scene

        print(label_errors(Scene.open(args.scene), args.recording).table())
        return 0
    from sensors.synthetic.demo import run_demo

    return run_demo(args.out, quick=args.quick)


def _record(args: argparse.Namespace) -> Truth:
    width, height = args.size or (None, None)
    given = {"frames": args.frames, "width": width, "height": height, "seed": args.seed}
    if args.simulated:
        from sensors.synthetic.simulated import SimulatedOptions, make_simulated_recording

        given |= {"sweep_deg": args.arc, "quality": args.quality}
        return make_simulated_recording(args.out, SimulatedOptions(**_given_only(given)))
    from sensors.synthetic.recording import RecordingOptions, make_recording

    if args.quality is not None:
        raise ToolkitError("is for simulated recordings only", field="--quality")
    return make_recording(
        args.out, RecordingOptions(**_given_only(given | {"arc_degrees": args.arc}))
    )


def _given_only(given: dict[str, Any]) -> dict[str, Any]:
    return {name: value for name, value in given.items() if value is not None}


if __name__ == "__main__":
    sys.exit(main())
