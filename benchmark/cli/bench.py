"""`std-bench`: score depth restorers, pose methods and grasp planners."""

from __future__ import annotations

import sys
from typing import TYPE_CHECKING

from benchmark.cli import commands, report_failures
from std_toolkit.cli.command import Program, print_json

if TYPE_CHECKING:
    from benchmark.evaluation.config import BopConfig, NetworkConfig
    from benchmark.evaluation.query_options import (
        AuditOptions,
        BakeoffOptions,
        CheckDataOptions,
        InferListOptions,
        ListOptions,
        OrderOptions,
        SelfTestOptions,
        SpeedOptions,
        VerifyOptions,
    )
    from benchmark.methods.pose.priors.options import PriorsCommand


def score(config: NetworkConfig | BopConfig) -> int:
    """Score methods or result files; returns the exit status."""
    from benchmark.evaluation.evaluate import score_config

    scored = score_config(config)
    if config.json:
        print_json(scored.records)
    elif scored.results:
        print(scored.table)
    return report_failures(scored.campaign.failed) or int(scored.campaign.failed_frames > 0)


def list_names(options: ListOptions) -> int:
    """Print methods or splits with a line about each, or published figures; returns the exit
    status."""
    if options.what == "published":
        from benchmark.report.parts.published import TASKS, published_records, published_tables

        tasks = TASKS[options.task]
        if options.json:
            print_json(published_records(tasks))
        else:
            print("\n\n".join(table.terminal() for table in published_tables(tasks)))
        return 0
    from benchmark.data.splits import get_split, splits
    from benchmark.methods.registry import METHODS

    if options.what == "splits":
        about = {name: get_split(name).about for name in splits.names()}
    else:
        methods = METHODS[options.task]
        about = {name: methods.about(name) for name in methods.names()}
        if options.task == "grasp":
            about["oracle"] = "Knows where the objects are: what can be reached at all."
    if options.json:
        print_json([{"name": name, "about": text} for name, text in about.items()])
    else:
        width = 24 if options.what == "splits" else 16
        print("\n".join(f"{name:{width}} {text}" for name, text in about.items()))
    return 0


def check_data(options: CheckDataOptions) -> int:
    """Print what of some splits is there; returns the exit status."""
    from benchmark.data.check import check_split

    reports = [check_split(options.root, name) for name in options.splits]
    if options.json:
        print_json([report.record() for report in reports])
    else:
        print("\n".join(report.text() for report in reports))
    return 0 if all(report.is_complete for report in reports) else 1


def infer_list(options: InferListOptions) -> int:
    """Write the list of frames for other programs; returns the exit status."""
    from benchmark.evaluation.infer_list import write_infer_list

    print(write_infer_list(options))
    return 0


def order_points(options: OrderOptions) -> int:
    """Score the order of points; returns the exit status."""
    from benchmark.evaluation.tasks.order_run import order_table, score_order

    scored = score_order(options)
    if options.json:
        print_json(scored.record)
    elif scored.record.scores:
        print(order_table(scored.record).terminal())
    return report_failures(scored.campaign.failed) or int(scored.campaign.failed_frames > 0)


def self_test(options: SelfTestOptions) -> int:
    """Compare the networks' answers with pinned ones; returns the exit status."""
    from benchmark.methods.known import self_test as tests

    rows, failed = [], {}
    for done in tests.self_test(tests.pinned(options.networks)):
        known = done.pinned
        row = {
            "network": known.case, "seed": known.seed, "by": known.by, "apart": done.apart,
            "good": done.is_good, "seconds": round(done.seconds, 2),
        }  # fmt: skip
        rows.append(row)
        if not done.is_good:
            most = tests.TOLERANCE[known.by]
            problem = done.error or f"differs by {done.apart:.2g}, more than {most:g}"
            failed[f"{known.case}, seed {known.seed}"] = problem
        if not options.json:
            shown = f"{known.case:22} seed {known.seed}  of the {known.by:8}"
            print(f"{shown} {done.apart:8.1e}  {'good' if done.is_good else 'FAILED'}")
    if options.json:
        print_json(rows)
    return report_failures(failed)


def speeds(options: SpeedOptions) -> int:
    """Measure the speed of networks; returns the exit status."""
    from benchmark.evaluation.tasks.speed_run import measure_speeds, speed_table
    from benchmark.report.parts.published import published_tables

    found = list(measure_speeds(options))
    if options.json:
        print_json(found)
    else:
        tables = [speed_table(found), *published_tables(("speed",))]
        print("\n\n".join(table.terminal() for table in tables))
    return report_failures({row.method: row.error for row in found if row.error})


def verify_results(options: VerifyOptions) -> int:
    """Check results; returns the exit status."""
    from benchmark.evaluation.verification import VERIFICATION
    from benchmark.evaluation.verify import summary, verify
    from std_toolkit.io.documents import write_document
    from std_toolkit.log import logger

    done = verify(options)
    out = options.out or options.results[0] / VERIFICATION
    write_document(out, done)
    if options.json:
        print_json(done)
    else:
        print("\n".join(summary(done)))
    logger.info("%s", out)
    return 0 if all(run.holds for run in done.runs) else 1


def choose(options: BakeoffOptions) -> int:
    """Say which depth restorer to use; returns the exit status."""
    from benchmark.recipes.bakeoff import bakeoff

    done = bakeoff(options)
    if options.json:
        print_json(done.record)
    else:
        print("\n".join(done.lines))
    return report_failures(done.failed)


def audit_labels(options: AuditOptions) -> int:
    """Judge labels and write the page; returns the exit status."""
    from benchmark.evaluation.audit.run import run_audit
    from benchmark.report.page import make_parts, render_page
    from std_toolkit.io.atomic import write_bytes_atomic

    audit = run_audit(options)
    parts = make_parts([options.out])
    page = options.out / "report.html"
    write_bytes_atomic(page, render_page(parts).encode())
    if options.json:
        print_json(audit)
    else:
        print("\n\n".join(part.terminal for part in parts))
        print(f"\n{parts[0].summary}\n{page}")
    unread = {s.scene: p for s in audit.scenes for p in s.problems[:1]}
    return report_failures(unread)


def write_priors(options: PriorsCommand) -> int:
    """Make shape priors; returns the exit status."""
    from benchmark.methods.pose.priors.make_priors import make_priors
    from benchmark.methods.pose.priors.prior_file import save_priors
    from std_toolkit.log import logger

    priors = make_priors(options)
    save_priors(options.out, priors)
    logger.info("%s: %d categories", options.out, len(priors.points))
    return 0


_QUERY = "benchmark.evaluation.query_options:"
_PRIORS = "benchmark.methods.pose.priors.options:PriorsCommand"
PROGRAM = Program(
    name="std-bench",
    about="Score methods that restore depth, and what rests on depth: poses and grasps. What is\n"
    "scored already is kept: run the same command again to resume. `std-report` makes tables and\n"
    "pages of the results.",
    commands=commands(
        "benchmark.cli.bench",
        "benchmark.evaluation.config",
        ("depth", "score depth restorers", "DepthConfig", "score"),
        ("pose", "score category-level pose methods", "PoseConfig", "score"),
        ("grasp", "clear tables in simulation", "GraspConfig", "score"),
        ("bop", "score result files of instance-level poses", "BopConfig", "score"),
        ("list", "list methods, splits or published figures", _QUERY + "ListOptions", "list_names"),
        (
            "check-data",
            "report what of a split is there, and what is missing",
            _QUERY + "CheckDataOptions",
            "check_data",
        ),
        (
            "infer-list",
            "write the list of frames for a program of another environment",
            _QUERY + "InferListOptions",
            "infer_list",
        ),
        (
            "order",
            "score the order of points on layers of glass",
            _QUERY + "OrderOptions",
            "order_points",
        ),
        (
            "self-test",
            "compare the networks' answers with pinned ones",
            _QUERY + "SelfTestOptions",
            "self_test",
        ),
        (
            "speed",
            "measure how fast networks are, without weights and data",
            _QUERY + "SpeedOptions",
            "speeds",
        ),
        (
            "verify",
            "check figures of results, with the data by making them again",
            _QUERY + "VerifyOptions",
            "verify_results",
        ),
        (
            "bakeoff",
            "say which depth restorer to use for your camera",
            _QUERY + "BakeoffOptions",
            "choose",
        ),
        ("audit", "judge the labels of a data set", _QUERY + "AuditOptions", "audit_labels"),
        ("priors", "make the shape priors of spd and sgpa from meshes", _PRIORS, "write_priors"),
    ),
    default="depth",
)
main = PROGRAM.main

if __name__ == "__main__":
    sys.exit(main())
