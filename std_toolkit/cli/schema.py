"""`std-curate schema`: JSON Schema of the documents."""

from __future__ import annotations

import argparse
from pathlib import Path


def add_parser(subparsers: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    parser = subparsers.add_parser(
        "schema",
        help="print or write the JSON Schema of the documents",
        description="Print the JSON Schema of one document, or write those of all to a folder.",
    )
    parser.add_argument("document", nargs="?", metavar="DOCUMENT", help="such as scene or poses")
    parser.add_argument("--out", type=Path, metavar="DIR", help="write all schemas to this folder")
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    from std_toolkit.cli.document_schema import document_types, schema_bytes, write_schemas

    if args.out is not None:
        for path in write_schemas(args.out):
            print(path)
    elif args.document is not None:
        print(schema_bytes(args.document).decode(), end="")
    else:
        print("\n".join(document_types()))
    return 0
