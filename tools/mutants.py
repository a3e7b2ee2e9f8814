"""Mutation testing: do the tests detect small changes of the code?  `make mutants`.

Cosmic Ray creates the mutants: it changes one operator, number or condition of a module. A seeded
sample, as many from each area, is drawn over the modules where an undetected mistake costs most.
Each mutant runs in a copy of the repository against the tests that execute the changed lines, quick
tests first, up to `--seconds` of them. Lines compiled by numba, which coverage does not record, and
lines that run at import, such as the limits in settings, use the tests of their module. A mutant
that no test detects survives and is listed with its diff. After `--hours` no further one begins.

Skipped are changes that no test can detect, in annotations, decorators, error messages and code for
type checkers; bit operators in place of arithmetic, which every test would detect; and identity in
place of an order comparison or the reverse. A test that is skipped in a mutant counts as failed,
because it runs without the mutation. A stopped run resumes.

Exit status: 0 if at least `--least` of the mutants died, else 1.
"""

from __future__ import annotations

import argparse
import ast
import itertools
import json
import os
import random
import re
import shutil
import sqlite3
import subprocess
import sys
import time
from collections import defaultdict
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import asdict, dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
# Area: its modules, and the tests that may detect a change of them.
AREAS: dict[str, tuple[tuple[str, ...], tuple[str, ...]]] = {
    "geometry": (("std_toolkit/geometry/*.py",), ("tests/std_toolkit/geometry",)),
    "renderers": (
        ("std_toolkit/rendering/*.py",),
        (
            "tests/std_toolkit/rendering",
            "tests/std_toolkit/checks",
            "tests/std_toolkit/labels/support",
            "tests/annotator/views/test_cloud_reader.py",
        ),
    ),
    "scale": (
        ("std_toolkit/poses/*scale*.py", "std_toolkit/poses/known_points.py"),
        ("tests/std_toolkit/poses",),
    ),
    "poses": (("std_toolkit/poses/*.py",), ("tests/std_toolkit/poses",)),
    "gates": (("std_toolkit/checks/gates/*.py",), ("tests/std_toolkit/checks",)),
    "checks": (
        ("std_toolkit/checks/**/*.py",),
        ("tests/std_toolkit/checks", "tests/std_toolkit/faults"),
    ),
    "labels": (
        ("std_toolkit/labels/**/*.py",),
        ("tests/std_toolkit/labels", "tests/std_toolkit/faults"),
    ),
    "scanning": (("std_toolkit/scanning/**/*.py",), ("tests/std_toolkit/scanning",)),
    "importers": (("std_toolkit/importers/**/*.py",), ("tests/std_toolkit/importers",)),
    "metrics": (("benchmark/metrics/**/*.py",), ("tests/benchmark/metrics",)),
    "resume": (
        ("benchmark/evaluation/engine.py", "benchmark/evaluation/results.py"),
        ("tests/benchmark/evaluation", "tests/benchmark/report/test_report_oddities.py"),
    ),
    "exporters": (("std_toolkit/exporters/*.py",), ("tests/std_toolkit/exporters",)),
    "collision": (
        ("benchmark/metrics/grasp/collision.py", "benchmark/tabletop/grasp.py"),
        ("tests/benchmark/metrics", "tests/benchmark/tabletop"),
    ),
    "tabletop": (("benchmark/tabletop/**/*.py",), ("tests/benchmark/tabletop",)),
    "restoring": (("benchmark/restoring/**/*.py",), ("tests/benchmark/restoring",)),
    "sensors": (("sensors/**/*.py",), ("tests/sensors",)),
}
_DURATION = re.compile(r"^([\d.]+)s (?:call|setup)\s+(\S.*)$")
# Between numbers these raise an error, which any test detects.
_BITS = ("BitOr", "BitAnd", "BitXor", "LShift", "RShift", "Invert")
_ORDER = "(Lt|LtE|Gt|GtE|Eq|NotEq)"
_IDENTITY = re.compile(rf"_{_ORDER}_(Is|IsNot)$|_(Is|IsNot)_{_ORDER}$")
_UNSEEN_CALLS = ("ToolkitError", "info", "warning", "debug")


# Tests that a mutant skips ran before: it broke what they need, such as a GL context.
_FAIL_SKIPPED = """
import pytest

@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(item, call):
    report = yield
    if report.skipped and not hasattr(report, "wasxfail"):
        report.outcome = "failed"
    return report
"""


@dataclass(frozen=True)
class Mutant:
    """One change of one module, and the tests to run."""

    area: str
    module: str
    operator: str
    occurrence: int
    line: int
    tests: tuple[str, ...]
    seconds: float

    @property
    def key(self) -> str:
        return f"{self.module}:{self.operator}:{self.occurrence}"


def main() -> int:
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n\n")[0])
    parser.add_argument("--count", type=int, default=300, help="mutants of the sample")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--workers", type=int, default=min(4, os.cpu_count() or 1))
    parser.add_argument("--least", type=float, default=0.85, help="share that must die")
    parser.add_argument("--seconds", type=float, default=120, help="tests of one mutant, at most")
    parser.add_argument("--area", choices=AREAS, nargs="+", default=list(AREAS))
    parser.add_argument("--out", type=Path, default=ROOT / "build" / "mutants")
    parser.add_argument("--hours", type=float, default=2, help="begin no mutant after that")
    args = parser.parse_args()
    deadline = time.time() + 3600 * args.hours
    out = args.out.resolve()
    # Coverage is measured with the tests of these areas only.
    measured = " ".join([_output("git", "rev-parse", "HEAD"), *args.area])
    if not (out / "commit").is_file() or (out / "commit").read_text() != measured:
        shutil.rmtree(out, ignore_errors=True)
        for number in range(args.workers):
            _copy_repository(out / f"copy{number}")
        _measure_coverage(out, args.area)
        (out / "commit").write_text(measured)
    for number in range(args.workers):
        _copy_repository(out / f"copy{number}")  # a killed run may have left a mutant
    mutants = [m for area in args.area for m in _mutants(area, out, args.seconds)]
    mutants = list({m.key: m for m in reversed(mutants)}.values())  # of its first area
    sample = _sample(mutants, args.count, args.seed)
    print(f"{len(sample)} of {len(mutants)} mutants, seed {args.seed}", flush=True)
    return _report(_run(sample, out, args.workers, deadline), args.least)


def _sample(mutants: list[Mutant], count: int, seed: int) -> list[Mutant]:
    """As many mutants of each area, as far as it has them, in random order."""
    draw = random.Random(seed)
    areas = [[m for m in mutants if m.area == area] for area in AREAS]
    for area in areas:
        draw.shuffle(area)
    rounds = itertools.zip_longest(*areas)
    return [m for mutants_of_all in rounds for m in mutants_of_all if m is not None][:count]


def _copy_repository(folder: Path) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    for name in _output("git", "ls-files", "-co", "--exclude-standard", "-z").split("\0"):
        source, target = ROOT / name, folder / name
        if name and source.is_file():
            if target.is_file() and target.read_bytes() == source.read_bytes():
                continue
            target.parent.mkdir(parents=True, exist_ok=True)
            shutil.copy2(source, target)


def _measure_coverage(out: Path, areas: list[str]) -> None:
    """Run the tests of the areas once: which test executes which line, and how long each takes."""
    tests = sorted({test for area in areas for test in AREAS[area][1]})
    command = [
        sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider",
        "-m", "not long",
        "--cov=std_toolkit", "--cov=benchmark", "--cov=sensors",
        "--cov-context=test", "--cov-report=",
        "--durations=0", "-vv", *tests,
    ]  # fmt: skip
    print("coverage of", " ".join(tests), flush=True)
    with (out / "coverage.log").open("w") as log:
        done = subprocess.run(
            command, cwd=out / "copy0", env=_environment(out / "copy0"), stdout=log
        )
    if done.returncode:
        raise SystemExit(f"error: the tests fail without a mutant; see {out / 'coverage.log'}")
    shutil.move(out / "copy0" / ".coverage", out / "coverage")


def _environment(copy: Path) -> dict[str, str]:
    # As in the workers of `make test`.
    data = os.environ.get("STD_TEST_DATA", str(ROOT.parent / "shared" / "data"))
    return {**os.environ, "PYTHONPATH": str(copy), "STD_TEST_DATA": data, "OMP_NUM_THREADS": "1"}


def _mutants(area: str, out: Path, seconds: float) -> list[Mutant]:
    """All mutants of an area that a test could detect."""
    from cosmic_ray.ast import ast_nodes, get_ast_from_path
    from cosmic_ray.plugins import get_operator, operator_names

    durations: dict[str, float] = defaultdict(float)
    for row in (out / "coverage.log").read_text().splitlines():
        if found := _DURATION.match(row):
            durations[found[2]] += float(found[1])
    operators = {
        n: get_operator(n)
        for n in operator_names()
        if not n.endswith(_BITS) and not _IDENTITY.search(n)
    }
    modules, _ = AREAS[area]
    made = []
    for path in sorted({p for glob in modules for p in ROOT.glob(glob)}):
        if path.name == "__init__.py":
            continue
        module = str(path.relative_to(ROOT))
        by_line = _tests_by_line(out / "coverage", module)
        of_module = {test for tests in by_line.values() for test in tests}
        at_import = {line for line, tests in by_line.items() if not tests}
        hidden, compiled = _unseen(path)
        tree = get_ast_from_path(path)
        for name, kind in operators.items():
            if kind.arguments():
                continue
            operator = kind()
            places = (p for n in ast_nodes(tree) for p in operator.mutation_positions(n))
            for occurrence, (start, _end) in enumerate(places):
                tests = by_line.get(start[0], set())
                if start[0] in compiled or start[0] in at_import or start[0] not in by_line:
                    tests = tests or of_module
                if any(a <= start < b for a, b in hidden) or not tests:
                    continue
                chosen, total = [], 0.0
                for test in sorted(tests, key=lambda t: (durations[t], t)):
                    if chosen and total + durations[test] > seconds:
                        break
                    chosen.append(test)
                    total += durations[test]
                made.append(Mutant(area, module, name, occurrence, start[0], tuple(chosen), total))
    return made


def _tests_by_line(coverage: Path, module: str) -> dict[int, set[str]]:
    """Tests that execute each line, without execution at import."""
    from coverage.numbits import numbits_to_nums

    lines: dict[int, set[str]] = defaultdict(set)
    with sqlite3.connect(coverage) as database:
        rows = database.execute(
            "SELECT context.context, line_bits.numbits FROM line_bits"
            " JOIN file ON file.id = line_bits.file_id"
            " JOIN context ON context.id = line_bits.context_id WHERE file.path LIKE ?",
            (f"%/{module}",),
        )
        for context, numbits in rows:
            for line in numbits_to_nums(numbits):
                lines[line].update({context.split("|")[0]} if context else ())
    return lines


def _unseen(path: Path) -> tuple[list[tuple[tuple[int, int], tuple[int, int]]], set[int]]:
    """Ranges in which no change has an effect, and lines compiled by numba."""
    ranges: list[tuple[tuple[int, int], tuple[int, int]]] = []
    compiled: set[int] = set()

    def hide(node: ast.AST | None) -> None:
        if node is not None:
            start = (node.lineno, node.col_offset)  # type: ignore[attr-defined]
            ranges.append((start, (node.end_lineno, node.end_col_offset)))  # type: ignore[attr-defined]

    source = path.read_text()
    for number, line in enumerate(source.splitlines(), 1):
        if line.strip() == "*,":  # Cosmic Ray parses it as a product
            ranges.append(((number, 0), (number + 1, 0)))
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.FunctionDef | ast.ClassDef):
            for decorator in node.decorator_list:
                hide(decorator)
                if "jit" in ast.unparse(decorator):
                    compiled.update(range(node.lineno, (node.end_lineno or 0) + 1))
        if isinstance(node, ast.FunctionDef):
            hide(node.returns)
        elif isinstance(node, ast.arg | ast.AnnAssign):
            hide(node.annotation)
        elif isinstance(node, ast.Call) and ast.unparse(node.func).endswith(".reshape"):
            for size in node.args:
                hide(size if ast.unparse(size) == "-1" else None)
        elif _is_unseen(node):
            hide(node)
    return ranges, compiled


def _is_unseen(node: ast.AST) -> bool:
    if isinstance(node, ast.Call):
        return ast.unparse(node.func).split(".")[-1] in _UNSEEN_CALLS
    if isinstance(node, ast.keyword):
        return node.arg == "strict"
    return isinstance(node, ast.If) and "TYPE_CHECKING" in ast.unparse(node.test)


def _run(sample: list[Mutant], out: Path, workers: int, deadline: float) -> list[dict[str, object]]:
    """Outcome of each mutant that began before the deadline; an earlier run's are reused."""
    kept = out / "results.jsonl"
    known = {}
    if kept.is_file():
        rows = (json.loads(line) for line in kept.read_text().splitlines() if line.endswith("}"))
        known = {row["key"]: row for row in rows}
    left = [m for m in sample if m.key not in known]
    copies = [out / f"copy{number}" for number in range(workers)]
    with kept.open("a") as file:
        pools = [ProcessPoolExecutor(1, initializer=_enter, initargs=(copy,)) for copy in copies]
        futures = [pools[i % workers].submit(_judge, m, deadline) for i, m in enumerate(left)]
        for number, future in enumerate(as_completed(futures), 1):
            row = future.result()
            if row is None:
                continue
            known[row["key"]] = row
            file.write(json.dumps(row) + "\n")
            file.flush()
            print(f"{number}/{len(left)} {row['outcome']:9} {row['key']}", flush=True)
    return [known[m.key] for m in sample if m.key in known]


def _enter(copy: Path) -> None:
    os.chdir(copy)
    os.environ.update(_environment(copy))


def _judge(mutant: Mutant, deadline: float) -> dict[str, object] | None:
    """The outcome of a mutant; None after the deadline."""
    if time.time() > deadline:
        return None
    from cosmic_ray.mutating import mutate_and_test
    from cosmic_ray.work_item import MutationSpec

    Path("mutant-tests.txt").write_text("\n".join(mutant.tests))
    Path("fail_skipped.py").write_text(_FAIL_SKIPPED)
    command = (
        f"{sys.executable} -m pytest -x -q -p no:cacheprovider -p fail_skipped -m ''"
        " @mutant-tests.txt"
    )
    place = (mutant.line, 0)
    spec = MutationSpec(
        module_path=Path(mutant.module), operator_name=mutant.operator,
        occurrence=mutant.occurrence, start_pos=place, end_pos=(mutant.line, 1),
    )  # fmt: skip
    result = mutate_and_test([spec], command, timeout=120 + 5 * mutant.seconds)
    row = asdict(mutant)
    row.update(key=mutant.key, tests=len(mutant.tests), diff=result.diff)
    row["outcome"] = str(getattr(result.test_outcome, "value", result.worker_outcome))
    return row


def _report(rows: list[dict[str, object]], least: float) -> int:
    survivors = [row for row in rows if row["outcome"] != "killed"]
    for row in sorted(survivors, key=lambda row: str(row["key"])):
        print(f"\n{row['outcome']}: {row['key']}, {row['tests']} tests\n{row['diff']}")
    print(f"\n{'area':12}{'mutants':>9}{'died':>7}{'share':>8}")
    for area in (*AREAS, "all"):
        chosen = [row for row in rows if area in (row["area"], "all")]
        died = sum(row["outcome"] == "killed" for row in chosen)
        if chosen:
            print(f"{area:12}{len(chosen):9}{died:7}{100 * died / len(chosen):7.1f}%")
    return 0 if len(rows) - len(survivors) >= least * len(rows) else 1


def _output(*command: str) -> str:
    return subprocess.run(
        command, cwd=ROOT, check=True, capture_output=True, text=True
    ).stdout.strip()


if __name__ == "__main__":
    raise SystemExit(main())
