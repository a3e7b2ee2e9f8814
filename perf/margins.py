"""How near each limit of the check is to a right and to a wrong example.

    python perf/margins.py SCENE [--group checks.gates] [--every 6]

SCENE has right labels, such as `build/demo/scene` of `make demo`: it is the right example. The
wrong ones are the faults of tests/std_toolkit/checks/fault_table.py that must fail, every sixth of
them. All are measured once with the limits in force. Then each limit is changed by factors from 1.1
to 4, up and down, and the judge decides again. The table says by which factor the right example
fails first, and by which factor a wrong one passes first; "-" is beyond 4. A limit with two narrow
margins is set on these examples; one without any decides nothing here.

The limits that measuring itself uses are not changed: they would need all frames measured again.
"""

from __future__ import annotations

import argparse
import dataclasses
import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parent.parent / "tests/std_toolkit/checks"))

from fault_table import UP, Study, cases

from std_toolkit.checks.gates.judge import judge_scene
from std_toolkit.errors import ToolkitError
from std_toolkit.options import CheckOptions
from std_toolkit.scene import Scene
from std_toolkit.settings import Settings, every_group, override

FACTORS = (1.1, 1.25, 1.5, 2.0, 3.0, 4.0)
# What decides after the frames are measured.
JUDGED = ("checks.gates", "checks.measure.object_motion", "checks.measure.motion_solver",
          "checks.measure.aggregate")  # fmt: skip


@dataclass(frozen=True)
class Example:
    """A measured scene; `passes` judges it with the limits in force."""

    name: str
    right: bool
    passes: Callable[[CheckOptions], bool]


def examples(scene: Scene, every: int) -> Iterator[Example]:
    """The scene itself, and every so many of the faults that must fail."""
    study = Study(scene)

    def judged(measured: tuple[Any, ...]) -> Callable[[CheckOptions], bool]:
        where, observed, textures = measured
        return lambda options: (
            judge_scene(where, observed, {}, options, up=UP, compared=textures).passed
        )

    yield Example("right labels", True, judged((scene, study.base, study.textures)))
    wrong = [case for case in cases(scene) if case.wanted == "fail"]
    for case in wrong[::every]:
        yield Example(case.name, False, judged(study.measured(case)))


def limits(group: str) -> Iterator[tuple[str, str, float, Callable[[float], Any]]]:
    """Name, unit, value and a change (factor -> settings or options) of every numeric limit."""
    options = CheckOptions()
    for field in dataclasses.fields(options):
        value = getattr(options, field.name)
        if field.name.startswith(("max_", "min_")) and isinstance(value, float):
            yield (f"option {field.name}", "", value,
                   lambda f, n=field.name, v=value: replace(options, **{n: v * f}))  # fmt: skip
    for kind in every_group():
        if not kind.group.startswith(JUDGED) or not kind.group.startswith(group):
            continue
        now = kind.current()
        for field in dataclasses.fields(kind):
            value = getattr(now, field.name)
            if isinstance(value, int | float):
                yield (f"{kind.group}.{field.name}", field.metadata["unit"], value,
                       lambda f, s=now, n=field.name, v=value: changed(s, n, v, f))  # fmt: skip


def changed(now: Settings, name: str, value: float, factor: float) -> Settings:
    new = value * factor
    return replace(now, **{name: max(round(new), 0) if isinstance(value, int) else new})


def flips(example: Example, change: Callable[[float], Any]) -> float | None:
    """The factor nearest to 1 with which the verdict on an example is wrong."""
    for factor in (x for f in FACTORS for x in (f, 1 / f)):
        try:
            made = change(factor)
            if isinstance(made, Settings):
                with override(made):
                    passed = example.passes(CheckOptions())
            else:
                passed = example.passes(made)
        except ToolkitError:  # outside the range of the limit
            continue
        if passed != example.right:
            return factor
    return None


def main() -> int:
    """Print the table."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("scene", type=Path, help="a scene with right labels")
    parser.add_argument("--group", default="", help="only limits whose name begins so")
    parser.add_argument("--every", type=int, default=6, help="take every so many of the faults")
    args = parser.parse_args()
    found = list(examples(Scene.open(args.scene), args.every))
    kept = [e for e in found if e.passes(CheckOptions()) == e.right]
    for example in found:
        if example not in kept:
            print(f"left out, judged wrongly as it is: {example.name}")
    print(f"{len(kept)} examples, {sum(e.right for e in kept)} of them right\n")
    print(f"{'limit':52}{'value':>9}  {'right fails':>12}  {'wrong passes':>13}  example")
    for name, unit, value, change in limits(args.group):
        nearest: dict[bool, tuple[float, str]] = {}
        for example in kept:
            factor = flips(example, change)
            best = nearest.get(example.right)
            if factor and (best is None or _far(factor) < _far(best[0])):
                nearest[example.right] = factor, example.name
        right, wrong = nearest.get(True), nearest.get(False)
        print(
            f"{name:52}{value:>9.4g}  {_shown(right):>12}  {_shown(wrong):>13}  "
            f"{wrong[1] if wrong else ''}{f' [{unit}]' if unit else ''}",
            flush=True,
        )
    return 0


def _far(factor: float) -> float:
    return max(factor, 1 / factor)


def _shown(found: tuple[float, str] | None) -> str:
    return "-" if found is None else f"x {found[0]:.2f}"


if __name__ == "__main__":
    sys.exit(main())
