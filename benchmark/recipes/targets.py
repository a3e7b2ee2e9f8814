"""Frames of each test: the user's data, or simulated ones."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from benchmark.data.splits import get_split, open_split, where_to_get
from benchmark.published.load import SPLIT_OF
from benchmark.recipes.frame_sets import given_set, named_folders
from benchmark.recipes.recipe import Recipe, Test
from std_toolkit.errors import ToolkitError
from std_toolkit.log import logger

_DATASET_OF = {split: dataset for dataset, split in SPLIT_OF.items()}


@dataclass(frozen=True, kw_only=True)
class Target:
    """A test of a recipe.

    Attributes:
        name, title: for files and for people.
        dataset: the paper's name of it; empty where the paper has none.
        split: of the benchmark.
        root: folder of the data; None where they are simulated, or not available.
        set: name of the set that is simulated; empty for none.
        absent: what to do about a test that is not available; empty where it is.
    """

    name: str
    title: str
    dataset: str
    split: str
    root: Path | None = None
    set: str = ""
    absent: str = ""


def find_targets(recipe: Recipe, data: Sequence[str]) -> list[Target]:
    """All tests of a recipe, those that are not available, too.

    Args:
        data: what the user gives: `ROOT` of any number of data sets, or `TEST=ROOT` of one test.

    Raises:
        ToolkitError: no such test or folder, a folder that holds none of the tests, or one that
            does not hold the test that it is given for.
    """
    given = named_folders(data, tuple(recipe.tests), "test", "--data")
    named = {name: folder for name, folder in given if name}
    roots = [folder for name, folder in given if not name]
    used: set[Path] = set()
    targets = []
    for name, test in recipe.tests.items():
        split, root = _find(name, test, named.get(name), roots)
        if root is not None:
            used.add(root)
        targets.append(_target(name, test, split, root))
    others = [root for root in roots if root not in used]
    if others and not used:
        raise ToolkitError(
            "holds none of the recipe's tests",
            path=others[0],
            hint=f"they are {', '.join(recipe.tests)}; TEST=ROOT names the one that it is",
        )
    for root in others:
        logger.warning("%s: passed over, holds none of the recipe's tests", root)
    return targets


def _target(name: str, test: Test, split: str, root: Path | None) -> Target:
    known = get_split(split)
    simulated = test.set if root is None else ""
    absent = ""
    if root is None and not simulated:
        where = test.get if name != split else where_to_get(known)
        more = f"; {test.get}" if test.get and name == split else ""
        absent = f"{where}{more}; then: --data {name}=ROOT"
    dataset = test.dataset or ("" if name != split else _DATASET_OF.get(split, ""))
    return Target(
        name=name,
        title=test.title or dataset or name,
        dataset=dataset,
        split=split,
        root=root,
        set=simulated,
        absent=absent,
    )


def _find(
    name: str, test: Test, own: Path | None, roots: Sequence[Path]
) -> tuple[str, Path | None]:
    """Split and folder of a test; None where no data of the user's are its."""
    split = test.split or name
    if own is not None:
        try:
            open_split(split, own)
        except ToolkitError:
            if not split.startswith("dreds-"):
                raise
            # A set of std-sim lies in folders of its own names, whatever it is a test of.
            return given_set(name, own, "test").split, own
        return split, own
    if name != split:  # only the user knows which of the split's scenes are meant
        return split, None
    for root in roots:
        try:
            open_split(split, root)
        except ToolkitError:
            continue
        return split, root
    return split, None
