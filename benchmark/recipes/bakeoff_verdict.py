"""Which method to use: the rule of a bake-off.

Methods are compared by RMSE, frame by frame, on each kind of material. Frames of one view are not
independent, and views of one scene show the same objects: from six scenes on scenes are drawn and
swapped, below that views, and the conclusion holds for these objects alone. A method is named only
if it is better than every other one by the sign-flip test, p times the number of others; otherwise
the frames do not decide. The factor is enough: a wrong name needs a method that looks better than
the one that is best in truth, and there are as many chances for that as other methods. What a
method breaks of depth that the sensor had right is said beside.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal

import numpy as np
import pandas as pd

from benchmark.data.splits import FrameKey
from benchmark.evaluation.results import ERROR, FRAME, SCENE
from benchmark.metrics.depth import harm
from benchmark.metrics.significance import compare_methods, mean_interval
from std_toolkit.settings import Settings, limit

RAW = "raw"
HARD, ALL = "specular+transparent", "all"
# Subsets of the protocol that are ranked.
SUBSETS = (HARD, "transparent", "specular", "diffuse", ALL)
Kind = Literal["use", "on objects", "sensor", "undecided"]


@dataclass(frozen=True, kw_only=True)
class BakeoffSettings(Settings):
    """When a method is recommended."""

    harm: float = limit(0.01, source="what std-restore may spoil of good depth, in any place")
    """a method that breaks a larger share of good depth is not recommended for whole frames"""
    significant: float = limit(0.05, source="as in leaderboards")
    """largest corrected p of a difference that counts"""
    least_mm: float = limit(0.1, unit="mm", source="tables print no less")
    """a smaller difference of RMSE counts as none"""
    scenes: int = limit(6, source="2 / 2**6 is the first p below 0.05")
    """with fewer scenes, views are drawn instead"""


@dataclass(frozen=True)
class Value:
    """A mean with its 95 % interval, NaN where there is none."""

    mean: float
    low: float = float("nan")
    high: float = float("nan")

    def text(self, factor: float = 1.0, unit: str = "", digits: int = 1) -> str:
        """Number and interval for people.

        >>> Value(0.0123, 0.01, 0.015).text(1e3, " mm")
        '12.3 mm (10.0 to 15.0)'
        """
        shown = f"{factor * self.mean:.{digits}f}{unit}"
        if not np.isfinite([self.low, self.high]).all():
            return shown
        return f"{shown} ({factor * self.low:.{digits}f} to {factor * self.high:.{digits}f})"


@dataclass(frozen=True)
class Cost:
    """Seconds of a frame: mean and range of a few calls, and what they are."""

    seconds: Value
    what: str

    def __str__(self) -> str:
        return f"{self.seconds.text(unit=' s', digits=2)} {self.what}"


@dataclass(frozen=True)
class Ranking:
    """Methods on the pixels of one kind of material.

    Attributes:
        errors: RMSE in metres by method, the best first.
        behind: how much larger the RMSE of each other method is than that of the best, metres.
        tied: the best, and the methods that are not shown to be worse.
        frames, units: how many have such pixels.
    """

    errors: dict[str, Value]
    behind: dict[str, Value]
    tied: tuple[str, ...]
    frames: int
    units: int

    @property
    def best(self) -> str:
        return next(iter(self.errors))

    @property
    def decided(self) -> bool:
        return len(self.tied) == 1

    @property
    def needed(self) -> int:
        """Fewest views or scenes with which a difference of so many methods can be shown."""
        others = len(self.errors) - 1
        return int(np.ceil(np.log2(2 * others / BakeoffSettings.current().significant)))


@dataclass(frozen=True)
class Verdict:
    """Outcome of a bake-off.

    Attributes:
        kind: `use` a method for whole frames; `on objects`: it breaks what is around; `sensor`:
            none is better than the sensor's own depth; `undecided`.
        method: that to use; "" if undecided.
        main: the material that decides.
        rankings: by material.
        whole: those among methods that break little, where the best breaks more.
        harms: share of right depth that each method breaks, by method and region; regions without
            truth are missing.
        left_out: why a method does not compete, by method.
        unit: what was drawn, `scene` or `view`; frames, scenes: numbers of all.
    """

    kind: Kind
    method: str
    main: str
    rankings: dict[str, Ranking]
    whole: Ranking | None
    harms: dict[str, dict[str, Value]]
    left_out: dict[str, str]
    unit: str
    units: int
    frames: int
    scenes: int
    costs: Mapping[str, Cost] = field(default_factory=dict)

    def broken(self, method: str) -> dict[str, Value]:
        """Regions of which a method breaks more than is allowed."""
        return _broken(self.harms.get(method, {}))


def judge(
    rows: pd.DataFrame, views: Mapping[FrameKey, str], costs: Mapping[str, Cost] | None = None
) -> Verdict:
    """Decide which method to use.

    Args:
        rows: rows of the runs of all methods on one grid: `method`, `scene`, `frame`, `subset`,
            `rmse`, `n_pixels`, `error` and the columns of harm, which the first row of a frame has.
        views: name of the view of each frame.
        costs: time of methods, of those that were timed.

    Returns:
        The verdict, the same for the same rows.
    """
    rows = rows.assign(key=[FrameKey(s, f) for s, f in zip(rows[SCENE], rows[FRAME], strict=True)])
    left_out = _left_out(rows)
    scenes, frames = rows[SCENE].nunique(), rows["key"].nunique()
    by_scene = scenes >= BakeoffSettings.current().scenes
    rows["unit"] = rows[SCENE] if by_scene else rows["key"].map(views)
    harms = _harms(rows)
    rows = rows[~rows["method"].isin(left_out)]
    found = {name: _rank(rows, name) for name in SUBSETS}
    rankings = {name: ranking for name, ranking in found.items() if ranking is not None}
    main = HARD if HARD in rankings else ALL
    kind, method, whole = _decide(rows, rankings.get(main), main, harms)
    return Verdict(
        kind,
        method,
        main,
        rankings,
        whole,
        harms,
        left_out,
        "scene" if by_scene else "view",
        rows["unit"].nunique(),
        frames,
        scenes,
        costs or {},
    )


def _decide(
    rows: pd.DataFrame, ranking: Ranking | None, main: str, harms: Mapping[str, dict[str, Value]]
) -> tuple[Kind, str, Ranking | None]:
    """What to use, and the ranking of the methods that break little if the best breaks more."""
    if ranking is None or len(ranking.errors) < 2 or not ranking.decided:
        return "undecided", "", None
    if ranking.best == RAW:
        return "sensor", RAW, None
    if not _broken(harms.get(ranking.best, {})):
        return "use", ranking.best, None
    careful = [method for method in ranking.errors if not _broken(harms.get(method, {}))]
    return "on objects", ranking.best, _rank(rows[rows["method"].isin(careful)], main)


def _left_out(rows: pd.DataFrame) -> dict[str, str]:
    """Methods that did not answer every frame, and why."""
    frames = rows["key"].nunique()
    found = {}
    for method, part in rows.groupby("method", sort=False):
        wrong = part[part[ERROR] != ""]
        missing = frames - part["key"].nunique() + wrong["key"].nunique()
        if missing:
            why = f": {wrong[ERROR].iloc[0]}" if len(wrong) else ""
            found[str(method)] = f"no answer to {missing} of {frames} frames{why}"
    return found


def _broken(harms: Mapping[str, Value]) -> dict[str, Value]:
    most = BakeoffSettings.current().harm
    return {region: value for region, value in harms.items() if value.mean > most}


def _value(values: pd.Series, units: pd.Series) -> Value:
    found = mean_interval(values.to_numpy(float), units.to_numpy())
    return Value(float(found.mean), float(found.low), float(found.high))


def _harms(rows: pd.DataFrame) -> dict[str, dict[str, Value]]:
    firsts = rows.drop_duplicates(["method", "key"])
    found: dict[str, dict[str, Value]] = {}
    for method, part in firsts.groupby("method", sort=False):
        told = {name: part.dropna(subset=[name]) for name in harm.NAMES}
        found[str(method)] = {
            name: _value(some[name], some["unit"]) for name, some in told.items() if len(some)
        }
    return found


def _rank(rows: pd.DataFrame, subset: str) -> Ranking | None:
    """The ranking on one subset; None if no frame has such pixels."""
    part = rows[(rows["subset"] == subset) & (rows["n_pixels"] > 0)]
    if part.empty:
        return None
    means = part.groupby("method", sort=False)["rmse"].mean().sort_values(kind="stable")
    names = [str(name) for name in means.index]
    ordered = pd.concat([part[part["method"] == name] for name in names])
    errors = {n: _value(p["rmse"], p["unit"]) for n, p in ordered.groupby("method", sort=False)}
    # Views or scenes in the place of scenes: what is drawn and swapped together.
    units = ordered.drop(columns=[SCENE, FRAME]).rename(columns={"unit": SCENE, "key": FRAME})
    pairs = compare_methods(units[["method", SCENE, FRAME, "rmse"]], "rmse")
    behind, tied = {}, [names[0]]
    limits = BakeoffSettings.current()
    for pair in pairs[pairs["first"] == names[0]].to_dict("records"):
        # The best stands first: the difference is that of the other, turned around.
        behind[pair["second"]] = Value(-pair["difference"], -pair["high"], -pair["low"])
        p = (len(names) - 1) * pair["p_flip"]
        if not (p < limits.significant and -pair["difference"] >= limits.least_mm / 1000):
            tied.append(pair["second"])
    one = part[part["method"] == names[0]]
    return Ranking(errors, behind, tuple(tied), len(one), one["unit"].nunique())
