"""`std-bench --task bop`: result files of instance-level poses on a data set in BOP's layout."""

from __future__ import annotations

import argparse
from pathlib import Path

from std_toolkit.errors import ToolkitError


def score_bop_results(args: argparse.Namespace) -> int:
    """Score result files; returns the exit status."""
    from benchmark.metrics.bop import open_bop, read_bop_results, score_bop
    from benchmark.pose_running.bop_results import BopResult, bop_table, write_bop_result

    if len(args.data) != 1 or not Path(args.data[0]).is_dir():
        raise ToolkitError(
            "needs one folder of a data set in BOP's layout", field="--data", value=args.data
        )
    dataset = open_bop(args.data[0], args.bop_split)
    rows = []
    for path in args.results:
        estimates = read_bop_results(path)
        scores = score_bop(dataset, estimates)
        result = BopResult(
            results=path.stem,
            data=str(args.data[0]),
            split=args.bop_split,
            targets=sum(target.inst_count for target in dataset.targets),
            estimates=len(estimates),
            ar=scores.ar,
            ar_vsd=scores.vsd,
            ar_mssd=scores.mssd,
            ar_mspd=scores.mspd,
            seconds_per_image=scores.seconds_per_image,
        )
        rows.append(result)
        if args.out is not None:
            write_bop_result(args.out, result)
    print(bop_table(rows))
    return 0
