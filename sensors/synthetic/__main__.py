"""`python -m sensors.synthetic`: make a synthetic recording, score labels, run the demo."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from std_toolkit.errors import ToolkitError
from std_toolkit.log import log_to_stderr


def main() -> int:
    """Parse, call, print. Exit status: 0 done, 1 a failure."""
    parser = argparse.ArgumentParser(prog="python -m sensors.synthetic", description=__doc__)
    commands = parser.add_subparsers(dest="command", required=True, metavar="COMMAND")
    record = commands.add_parser("record", help="write a recording and its truth")
    record.add_argument("out", type=Path, metavar="DIR", help="folder to write")
    record.add_argument("--frames", type=int, default=120, help="default: 120")
    record.add_argument(
        "--arc", type=float, default=120.0, help="degrees around the table (default: 120)"
    )
    record.add_argument(
        "--size", type=int, nargs=2, default=(640, 480), metavar=("W", "H"), help="pixels"
    )
    record.add_argument("--seed", type=int, default=0)
    score = commands.add_parser("score", help="label error of a scene against the truth")
    score.add_argument("scene", type=Path, metavar="SCENE", help="labelled scene folder")
    score.add_argument("recording", type=Path, metavar="DIR", help="what `record` wrote")
    demo = commands.add_parser("demo", help="record, curate, score")
    demo.add_argument("out", type=Path, metavar="DIR", help="folder for everything")
    args = parser.parse_args()
    log_to_stderr()
    try:
        return _run(args)
    except ToolkitError as error:
        print(f"error: {error}", file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        print("interrupted; run the same command again to go on", file=sys.stderr)
        return 130


def _run(args: argparse.Namespace) -> int:
    if args.command == "record":
        from sensors.synthetic.annotation import write_annotations
        from sensors.synthetic.recording import RecordingOptions, make_recording

        options = RecordingOptions(
            frames=args.frames,
            arc_degrees=args.arc,
            width=args.size[0],
            height=args.size[1],
            seed=args.seed,
        )
        write_annotations(make_recording(args.out, options), args.out)
        print(
            f"{args.out}: {args.frames} frames in color/ and depth/ (millimetres), intrinsics.json,"
        )
        print(
            "meshes in models/, a pose of each object in frame 0 in annotation/ (as a person sets"
        )
        print("it: 1 px, 1 degree off), the truth in truth.json")
        return 0
    if args.command == "score":
        from sensors.synthetic.score import label_errors
        from std_toolkit.scene.scene import Scene

        print(label_errors(Scene.open(args.scene), args.recording).table())
        return 0
    from sensors.synthetic.demo import run_demo

    return run_demo(args.out)


if __name__ == "__main__":
    sys.exit(main())
