"""Recipes of experiments: sets of frames, variants trained on them, and tests.

A recipe is a TOML file; those of the toolkit are in `experiments/`. A `Scale`, read from
`scales.toml`, sets the size of a run: scenes, views, image size, steps and size of the networks.
"""

import re
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any, Literal

import msgspec

from benchmark.training.options import Machine, Precision
from std_toolkit.errors import ToolkitError, check_known, check_options
from std_toolkit.jobs.door import Writes
from std_toolkit.options import JobOptions, Seed

FOLDER = Path(__file__).with_name("experiments")

# Sets that every scale has.
BASE_SETS = ("train", "test")

# Depths of poses besides those of variants.
POSE_DEPTHS = ("raw", "gt")

# Variants, tests, ... of a recipe: each is compared with each other one on a page.
_MOST = 200

_NAME = re.compile(r"[a-z0-9][a-z0-9.-]*")

_FILE = Path(__file__).with_name("scales.toml")


class Printed(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A row of a paper's table, in the words of `published_results.csv`."""

    method: str
    training_data: str


class DerivedSet(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A set of simulated frames that differs from another one in some options.

    Attributes:
        like: the other one, `train` or `test`: the same scenes and views.
        options: fields of `SimulationOptions`.
    """

    like: str
    options: dict[str, Any]


class Test(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Frames that everything is scored on.

    Attributes:
        split: of the benchmark; the test's own name where it is left out.
        title: for people.
        dataset: what the paper calls it; the split's where it is left out.
        set: set of simulated frames that stands in where the user gives no data; empty for none.
        get: where the data come from, where the split does not know it.
    """

    split: str = ""
    title: str = ""
    dataset: str = ""
    set: str = ""
    get: str = ""


class Variant(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A network and what it is trained on.

    Attributes:
        title: its name in tables.
        method, settings: of `std-train`.
        set: frames that it is trained on.
        raw: what it is given as raw depth: the sensor's, or exact depth from which specular and
            transparent objects are cut.
        share: of the scenes that it is trained on.
        published: the row of the recipe's table that it is held against.
    """

    title: str
    method: str
    settings: dict[str, str] = {}
    set: str = "train"
    raw: Literal["sensor", "cut"] = "sensor"
    share: float = 1.0
    published: Printed | None = None


class PoseVariant(Variant, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A pose network, and the depth that its poses rest on; its row is of the table of poses.

    Variants of one method, settings and set share weights.

    Attributes:
        depth: `raw`, `gt`, or the name of a variant that restores depth.
        fit: of poses, see `std-bench pose`.
    """

    depth: str = "raw"
    fit: Literal["ransac", "paper"] = "ransac"


class Recipe(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """An experiment.

    Attributes:
        title, about: for people.
        table: the paper's, as `published_results.csv` names it; empty for none.
        variants, tests, sets: by name.
        baselines: methods without learning that are scored beside.
        protocols: that everything is scored by; the paper's own first.
        poses: pose networks on the depth of variants, by name.
        pose_table: the paper's table of poses; empty for none.
        pose_protocols: that poses are scored by.
        compare: pairs of names whose difference the page states, of variants and baselines or of
            poses; without any, the last with each other one.
    """

    title: str
    about: str = ""
    table: str = ""
    variants: dict[str, Variant]
    tests: dict[str, Test]
    sets: dict[str, DerivedSet] = {}
    baselines: list[str] = msgspec.field(default_factory=lambda: ["raw"])
    protocols: list[str] = msgspec.field(default_factory=lambda: ["paper", "strict"])
    poses: dict[str, PoseVariant] = {}
    pose_table: str = ""
    pose_protocols: list[str] = msgspec.field(default_factory=lambda: ["paper", "strict"])
    compare: list[tuple[str, str]] = []

    def __post_init__(self) -> None:
        trained = {f"variants.{n}": v for n, v in self.variants.items()}
        trained |= {f"poses.{n}": p for n, p in self.poses.items()}
        for part in ("variants", "tests", "sets", "poses"):
            for name in getattr(self, part):
                if not _NAME.fullmatch(name):
                    raise ToolkitError(
                        "names are lower-case letters, digits, . and -", field=part, value=name
                    )
        for part in ("variants", "tests", "sets", "poses", "baselines", "protocols", "compare"):
            if len(getattr(self, part)) > _MOST:
                raise ToolkitError(
                    f"at most {_MOST}", field=part, value=len(getattr(self, part)),
                    hint="divide the recipe",
                )  # fmt: skip
        for part in ("variants", "tests", "protocols"):
            if not getattr(self, part):
                raise ToolkitError("needs at least one", field=part)
        for name, derived in self.sets.items():
            if name in BASE_SETS:
                raise ToolkitError("the scale has this set", field="sets", value=name)
            check_known(derived.like, BASE_SETS, "no such set", field=f"sets.{name}.like")
        for name, pose in self.poses.items():
            depths = (*POSE_DEPTHS, *self.variants)
            check_known(pose.depth, depths, "no such depth", field=f"poses.{name}.depth")
        used = {part: v.set for part, v in trained.items()}
        used |= {f"tests.{n}": t.set for n, t in self.tests.items() if t.set}
        for part, value in used.items():
            check_known(value, (*BASE_SETS, *self.sets), "no such set", field=f"{part}.set")
        scored = {*self.variants, *self.baselines}
        for pair in self.compare:
            if not any(set(pair) <= names for names in (scored, set(self.poses))):
                raise ToolkitError(
                    "no two variants or poses of these names", field="compare", value=pair,
                    hint=f"variants: {', '.join(sorted(scored))}; poses: {', '.join(self.poses)}",
                )  # fmt: skip
        for part, variant in trained.items():
            if not 0 < variant.share <= 1:
                raise ToolkitError(
                    "must lie above 0 and at most 1", field=f"{part}.share", value=variant.share
                )


@dataclass(frozen=True, kw_only=True)
class RecipeMachine(Machine):
    """Where networks are trained: one process of this machine."""

    devices: int = field(default=1, metadata={"option": None})
    nodes: int = field(default=1, metadata={"option": None})
    log_every: int = field(default=50, metadata={"option": None})


@dataclass(frozen=True, kw_only=True)
class RecipeConfig:
    """Run an experiment: simulate and pack frames, train and score every variant, write the table.

    Published rows stand beside it. Run the same command again to resume. Without RECIPE: list
    recipes and scales.
    """

    recipe: str = field(default="", metadata={"option": ""})
    """name of a recipe, or FILE.toml"""
    scale: str = ""
    """tiny (a check that every step runs), small (minutes), medium (hours), paper (full size)"""
    out: Path = field(default=Path("recipe-runs"), metadata={"writes": Writes("parts")})
    """folder of all recipes: what several need is made once"""
    plan: bool = False
    """print what would be done, and do nothing"""
    allow_code: bool = False
    """import what the recipe names as file.py:NAME or package.module:NAME, which runs code; never
    with --plan"""
    only: tuple[str, ...] = ()
    """variants to run (all)"""
    seed: Seed = 0
    """of weights, order and held-out scenes"""
    steps: Annotated[int, msgspec.Meta(ge=1)] | None = None
    """of every training (the scale's)"""
    data: tuple[str, ...] = ()
    """[TEST=]ROOT of STD, DREDS, ClearGrasp to test on: folders above them, or of one test"""
    train_data: tuple[str, ...] = ()
    """[SET=]DIR of DREDS or of std-sim to train on, instead of simulating a set"""
    test_data: tuple[str, ...] = ()
    """[SET=]DIR, the same to test on"""
    validation_data: Path | None = None
    """set that chooses the best weights (scenes of the training data are held out)"""
    precision: Precision = "fp32"
    """arithmetic of training"""
    json: bool = False
    """print the list, or the table, as JSON"""
    machine: RecipeMachine = field(default_factory=RecipeMachine)
    jobs: JobOptions = field(default_factory=JobOptions)
    devices: tuple[str, ...] = field(default=("cpu",), metadata={"option": None})
    """torch devices to score on"""

    def __post_init__(self) -> None:
        check_options(self)


def recipe_names() -> list[str]:
    """Recipes of the toolkit, the paper's main comparison first."""
    names = sorted(path.stem for path in FOLDER.glob("*.toml"))
    return sorted(names, key=lambda name: name != "main-comparison")


def load_recipe(name: str) -> tuple[str, Recipe]:
    """A recipe of the toolkit by its name, or the user's own by its path (`*.toml`).

    Returns:
        Its name, and the recipe.

    Raises:
        ToolkitError: no such recipe, or a field of it is wrong.
    """
    from std_toolkit.io.foreign_files import read_toml

    if name in recipe_names():
        return name, read_toml(FOLDER / f"{name}.toml", Recipe)
    path = Path(name)
    if path.suffix != ".toml":
        raise ToolkitError(
            "no such recipe", value=name, hint=f"one of {', '.join(recipe_names())}, or FILE.toml"
        )
    return path.stem, read_toml(path, Recipe)


class SetSize(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A simulated set.

    Attributes:
        split: whose shapes, light and floors: `train` and `test` share none.
        scenes: how many there are.
        seed: of the first one; the others follow it.
        options: fields of `SimulationOptions`.
    """

    split: Literal["train", "test"]
    scenes: int
    seed: int
    options: dict[str, Any]


class Training(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """How a network is trained; what is not said is as published for it.

    Attributes:
        steps, batch_size, learning_rate, geometry: as in `TrainOptions`.
        settings: of the network, on top of its preset.
    """

    steps: int | None = None
    batch_size: int | None = None
    learning_rate: float | None = None
    geometry: Literal["published", "on", "off"] | None = None
    settings: dict[str, str] = {}


class Scale(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A scale.

    Attributes:
        about: what its numbers are worth; printed on every page.
        sets: `train` and `test`.
        preset: of the networks.
        hold_out: share of the training scenes that choose the best weights.
        training: of all methods.
        methods: what is otherwise for one of them.
        limit: frames of a test at most, evenly spread; None for all.
    """

    about: str
    sets: dict[str, SetSize]
    preset: Literal["compact", "published"]
    hold_out: float
    training: Training
    methods: dict[str, Training] = {}
    limit: int | None = None

    def __post_init__(self) -> None:
        if set(self.sets) != set(BASE_SETS):
            raise ToolkitError(f"must be {' and '.join(BASE_SETS)}", field="sets")

    def of(self, method: str) -> Training:
        """How a method is trained."""
        own = self.methods.get(method, Training())
        said = {k: v for k, v in msgspec.structs.asdict(own).items() if v is not None}
        settings = {**self.training.settings, **own.settings}
        return msgspec.structs.replace(self.training, **said | {"settings": settings})


def scales() -> dict[str, Scale]:
    """All scales, the smallest first."""
    from std_toolkit.io.foreign_files import read_toml

    return read_toml(_FILE, dict[str, Scale])


def get_scale(name: str) -> Scale:
    """A scale by its name.

    Raises:
        ToolkitError: there is none.
    """
    known = scales()
    check_known(name, known, "no such scale", field="--scale")
    return known[name]
