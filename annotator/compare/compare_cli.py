"""`std-annotate compare` and `std-annotate merge`: several annotators of one recording."""

from __future__ import annotations

import argparse
from pathlib import Path

Subparsers = argparse._SubParsersAction  # argparse has no public name for it


def add_parsers(subparsers: Subparsers[argparse.ArgumentParser]) -> None:
    """Add both commands; each sets `run(args) -> exit status`."""
    _add_compare(subparsers)
    _add_merge(subparsers)


def _add_compare(subparsers: Subparsers[argparse.ArgumentParser]) -> None:
    parser = subparsers.add_parser(
        "compare",
        help="how far the labels of two annotators of one recording are apart",
        description="Compare the labels of two annotators of one recording (or of one annotator "
        "at two times): distance of the surfaces (MSSD), turn, shift along the viewing ray and "
        "across it, symmetry aware. Disagreements come first, with what differs mostly. Changes "
        "neither scene. Exit status 0 if all objects labelled by both agree, 1 if some do not.",
    )
    parser.add_argument("a", type=Path, metavar="A", help="scene folder of the one annotator")
    parser.add_argument("b", type=Path, metavar="B", help="scene folder of the other")
    _add_common(parser)
    parser.add_argument(
        "--out",
        type=Path,
        metavar="FOLDER",
        help="write agreement.csv, frames.csv, agreement.json and a picture of every disagreement",
    )
    parser.add_argument("--csv", type=Path, metavar="FILE", help="write the table of objects")
    parser.set_defaults(run=run_compare)


def _add_merge(subparsers: Subparsers[argparse.ArgumentParser]) -> None:
    parser = subparsers.add_parser(
        "merge",
        help="one set of labels from those of several annotators of one recording",
        description="Merge the labels of two or more annotators of one recording, called A, B, "
        "C, ... in the order of the folders. Where they agree, the object gets the mean of their "
        "poses; otherwise it gets no label unless an option resolves it. The merged "
        "folders are not changed. Exit status 0 if every object has a label, 1 if some were left "
        "open.",
    )
    parser.add_argument(
        "scenes", type=Path, nargs="+", metavar="SCENE", help="scene folder of each annotator"
    )
    where = parser.add_mutually_exclusive_group(required=True)
    where.add_argument(
        "--out",
        type=Path,
        metavar="FOLDER",
        help="make a new scene: a copy of the first one's recording and camera poses",
    )
    where.add_argument(
        "--into",
        type=Path,
        metavar="SCENE",
        help="write the labels into another scene of the recording",
    )
    parser.add_argument(
        "--overwrite", action="store_true", help="with --into: replace all labels that are there"
    )
    _add_common(parser)
    parser.add_argument(
        "--prefer", metavar="X", help="where they disagree, take the label of annotator X"
    )
    parser.add_argument(
        "--take",
        action="append",
        default=[],
        metavar="OBJECT=X",
        help="take annotator X's label of this object; may be repeated",
    )
    parser.add_argument(
        "--single", action="store_true", help="take labels that only one annotator made"
    )
    parser.add_argument(
        "--majority",
        action="store_true",
        help="of three or more, more than half that agree outvote the others",
    )
    parser.set_defaults(run=run_merge)


def _add_common(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--threshold-mm",
        type=float,
        default=5.0,
        metavar="N",
        help="largest MSSD of two labels that agree (default: 5)",
    )
    parser.add_argument(
        "--as-annotated",
        action="store_true",
        help="take the poses as set by hand, before any refinement over several frames",
    )


def run_compare(args: argparse.Namespace) -> int:
    """Compare two annotators; returns 1 if an object labelled by both disagrees."""
    from annotator.compare import CompareOptions, compare_labels
    from annotator.compare.comparison_report import comparison_lines, write_csv, write_tables
    from std_toolkit.scene import Scene

    options = CompareOptions(threshold_mm=args.threshold_mm, as_annotated=args.as_annotated)
    comparison = compare_labels(Scene.open(args.a), Scene.open(args.b), options)
    print("\n".join(comparison_lines(comparison)))
    if args.csv is not None:
        write_csv(comparison, args.csv)
    if args.out is not None:
        from annotator.compare.comparison_report import write_pictures

        written = [*write_tables(comparison, args.out), *write_pictures(comparison, args.out)]
        print(f"written: {', '.join(str(p) for p in written)}")
    return 1 if comparison.disagreements else 0


def run_merge(args: argparse.Namespace) -> int:
    """Merge annotators; returns 1 if an object is left without a label."""
    from annotator.compare import MergeOptions, merge_labels
    from annotator.compare.comparison_report import merge_lines
    from annotator.compare.merge_output import check_target, write_into, write_scene
    from std_toolkit.errors import ToolkitError
    from std_toolkit.io.atomic import check_vacant
    from std_toolkit.scene import Scene

    if args.overwrite and args.into is None:
        raise ToolkitError("--overwrite needs --into; a new scene replaces nothing")
    options = MergeOptions(
        threshold_mm=args.threshold_mm,
        as_annotated=args.as_annotated,
        prefer=args.prefer,
        take=_taken(args.take),
        single=args.single,
        majority=args.majority,
    )
    # Fail before the computation, not after it.
    if args.out is not None:
        check_vacant(args.out)
    else:
        check_target(args.into, args.scenes)
    scenes = [Scene.open(path) for path in args.scenes]
    target = None if args.into is None else Scene.open(args.into)
    merge = merge_labels(scenes, options, target=target)
    if args.out is not None:
        written = write_scene(merge, args.out)
    else:
        written = write_into(merge, overwrite=args.overwrite)
    print("\n".join(merge_lines(merge, written.root)))
    return 1 if merge.open else 0


def _taken(arguments: list[str]) -> dict[str, str]:
    from std_toolkit.errors import ToolkitError

    taken: dict[str, str] = {}
    for text in arguments:
        name, sign, owner = text.rpartition("=")
        if not (sign and name and owner):
            raise ToolkitError(
                "must be OBJECT=ANNOTATOR, such as mug=B", field="--take", value=text
            )
        if name in taken:
            raise ToolkitError("given twice for one object", field="--take", value=name)
        taken[name] = owner
    return taken
