"""From a recipe, a scale and the user's data to everything that is to be done."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from benchmark.evaluation.tasks.depth import Run
from benchmark.methods.registry import MethodOptions, make_restorer
from benchmark.published.load import published_table
from benchmark.recipes.frame_sets import FrameSet, given_set, parse_given, plan_set
from benchmark.recipes.recipe import Printed, Recipe, Scale, Variant, get_scale, load_recipe
from benchmark.recipes.targets import Target, find_targets
from benchmark.training.run_files import BEST
from std_toolkit.errors import ToolkitError

if TYPE_CHECKING:
    from benchmark.training.plan import TrainWishes


@dataclass(frozen=True, kw_only=True)
class RecipeConfig:
    """What a user asks for.

    Attributes:
        recipe, scale: names.
        out: folder of all recipes: what several need is made once.
        train_data, test_data: `[SET=]DIR` of sets that are not to be simulated.
        validation_data: set that chooses the best weights; else scenes are held out.
        data: `[TEST=]ROOT` of data sets to test on.
        only: variants; all where it is empty.
        seed: of weights, order and held-out scenes.
        steps: of every training; else the scale's.
        devices: torch devices to score on.
    """

    recipe: str
    scale: str
    out: Path
    train_data: Sequence[str] = ()
    test_data: Sequence[str] = ()
    validation_data: Path | None = None
    data: Sequence[str] = ()
    only: Sequence[str] = ()
    seed: int = 0
    steps: int | None = None
    devices: tuple[str, ...] = ("cpu",)


@dataclass(frozen=True, kw_only=True)
class Pack:
    """Frames of a set at the size of a network."""

    folder: Path
    frames: FrameSet
    size: tuple[int, int]
    raw: Literal["sensor", "cut"]


@dataclass(frozen=True, kw_only=True)
class Entry:
    """What is scored: a variant with its training, or a method without learning.

    Attributes:
        name: in the recipe.
        title: in tables.
        label: in names of files; the same training has the same in every recipe.
        method, preset, settings: of the restorer.
        published: the printed row beside it.
        packs: that it is trained on, and judged by where those are others.
        wishes: of the training, and `folder` of it; None without learning.
        problem: why it cannot run.
    """

    name: str
    title: str
    label: str
    method: str
    preset: str = "compact"
    settings: Mapping[str, str] = field(default_factory=dict)
    published: Printed | None = None
    packs: tuple[Pack, ...] = ()
    wishes: TrainWishes | None = None
    folder: Path | None = None
    problem: str = ""


@dataclass(frozen=True, kw_only=True)
class RecipePlan:
    """All steps.

    Attributes:
        name, recipe, scale_name, scale: what is run.
        folder: of the page.
        sets: that are needed, by name.
        packs: that are needed, each once.
        entries: methods without learning first.
        targets: the tests.
        out, devices: of the scores.
    """

    name: str
    recipe: Recipe
    scale_name: str
    scale: Scale
    folder: Path
    sets: Mapping[str, FrameSet]
    packs: Sequence[Pack]
    entries: Sequence[Entry]
    targets: Sequence[Target]
    out: Path
    devices: tuple[str, ...]

    def place(self, target: Target) -> tuple[str, Path, str] | None:
        """Split and folder of a test and the name of its results; None if it is not at hand."""
        if target.set:
            frames = self.sets[target.set]
            return frames.split, frames.root, f"simulated-{frames.name}"
        if target.root is None:
            return None
        digest = hashlib.sha256(str(target.root.resolve()).encode()).hexdigest()[:8]
        return target.split, target.root, f"{target.name}-{digest}"

    def runs(self, entry: Entry) -> list[tuple[Target, Run]]:
        """Scores of an entry on all tests that are at hand."""
        weights = None if entry.folder is None else entry.folder / BEST
        options = MethodOptions(preset=entry.preset, weights=weights, settings=entry.settings)
        found = []
        for target in self.targets:
            place = self.place(target)
            if place is None:
                continue
            split, root, name = place
            found += [
                (
                    target,
                    Run(
                        split=split,
                        root=root,
                        method=entry.method,
                        options=options,
                        protocol=protocol,
                        label=entry.label,
                        out=self.out / "results" / name,
                        devices=self.devices if entry.folder else ("cpu",),
                        limit=self.scale.limit,
                        speed=False,
                    ),
                )
                for protocol in self.recipe.protocols
            ]
        return found


def plan_recipe(wishes: RecipeConfig) -> RecipePlan:
    """Everything that is to be done; nothing is made yet.

    A variant that cannot be trained here is in the plan with its problem.

    Raises:
        ToolkitError: no such recipe, scale, variant, set, test or folder.
    """
    name, recipe = load_recipe(wishes.recipe)
    scale = get_scale(wishes.scale)
    if recipe.table:
        published_table(recipe.table)  # a wrong name is told before anything is made
    if strange := [v for v in wishes.only if v not in recipe.variants]:
        raise ToolkitError(
            "the recipe has no such variant",
            field="--only",
            value=strange[0],
            hint=f"it has {', '.join(recipe.variants)}",
        )
    if wishes.steps is not None and wishes.steps < 1:
        raise ToolkitError("must be at least 1", field="--steps", value=wishes.steps)
    out = wishes.out / wishes.scale
    train = parse_given(wishes.train_data, "train", recipe)
    test = parse_given(wishes.test_data, "test", recipe)
    if twice := train.keys() & test.keys():
        raise ToolkitError("two folders for one set", value=min(twice))
    given = train | test
    judged_by = wishes.validation_data
    validation = None if judged_by is None else given_set("validation", judged_by, "val")
    targets = find_targets(recipe, wishes.data)
    variants = {k: v for k, v in recipe.variants.items() if not wishes.only or k in wishes.only}
    needed = [v.set for v in variants.values()] + [t.set for t in targets if t.set]
    sets = {one: plan_set(one, recipe, scale, given, out) for one in dict.fromkeys(needed)}
    if unused := [one for one in given if one not in sets and one not in _likes(recipe, sets)]:
        raise ToolkitError("the recipe has no use for this set", value=unused[0])
    for method in recipe.baselines:
        make_restorer(method)  # a wrong name is told before anything is made
    baselines = [
        Entry(name=method, title=method, label=method.replace(":", "."), method=method)
        for method in recipe.baselines
    ]
    trained = {
        key: _entry(key, variant, wishes, scale, sets[variant.set], validation, out)
        for key, variant in variants.items()
    }
    usable = {key: entry for key, entry in trained.items() if not entry.problem}
    packs = {pack.folder: pack for entry in usable.values() for pack in entry.packs}
    used = {variants[key].set for key in usable} | {t.set for t in targets if t.set}
    extra = "" if not wishes.seed else f".seed-{wishes.seed}"
    extra += "" if wishes.steps is None else f".steps-{wishes.steps}"
    return RecipePlan(
        name=name,
        recipe=recipe,
        scale_name=wishes.scale,
        scale=scale,
        folder=out / f"{name}{extra}",
        sets={key: frames for key, frames in sets.items() if key in used},
        packs=list(packs.values()),
        entries=[*baselines, *trained.values()],
        targets=[_told(target, recipe, sets) for target in targets],
        out=out,
        devices=wishes.devices,
    )


def _told(target: Target, recipe: Recipe, sets: Mapping[str, FrameSet]) -> Target:
    """The test, with a title that no one takes for the published data set's."""
    if not target.set or recipe.tests[target.name].title or not sets[target.set].is_simulated:
        return target
    return replace(target, title=f"{target.title}, simulated anew")


def _likes(recipe: Recipe, sets: Mapping[str, FrameSet]) -> set[str]:
    """Sets whose scenes others take."""
    return {recipe.sets[name].like for name in sets if name in recipe.sets}


def _entry(
    name: str,
    variant: Variant,
    wishes: RecipeConfig,
    scale: Scale,
    frames: FrameSet,
    validation: FrameSet | None,
    out: Path,
) -> Entry:
    from benchmark.training.catalogue import get_trainable
    from benchmark.training.plan import TrainWishes

    told = Entry(
        name=name,
        title=variant.title,
        label=_label(variant, frames, validation, wishes),
        method=variant.method,
        preset=scale.preset,
        published=variant.published,
    )
    how = scale.of(variant.method)
    try:
        trainable = get_trainable(variant.method)
        settings = trainable.settings_of(scale.preset, {**how.settings, **variant.settings})
        size = tuple(trainable.config(scale.preset, settings).input_size)
    except ToolkitError as error:
        return replace(told, problem=f"cannot be trained here: {error}")
    packs = [
        Pack(
            folder=out / "packs" / _pack_name(one, size, variant.raw),
            frames=one,
            size=size,
            raw=variant.raw,
        )
        for one in (frames, validation)
        if one is not None
    ]
    train = TrainWishes(
        method=variant.method,
        preset=scale.preset,
        settings={**how.settings, **variant.settings},
        data=[packs[0].folder],
        validation=[pack.folder for pack in packs[1:]],
        hold_out=scale.hold_out,
        share=variant.share,
        steps=how.steps if wishes.steps is None else wishes.steps,
        batch_size=how.batch_size,
        learning_rate=how.learning_rate,
        geometry=how.geometry or "published",
        seed=wishes.seed,
    )
    return replace(
        told,
        settings=settings,
        packs=tuple(packs),
        wishes=train,
        folder=out / "training" / told.label,
    )


def _pack_name(frames: FrameSet, size: tuple[int, int], raw: str) -> str:
    cut = "" if raw == "sensor" else f".{raw}"
    return f"{frames.name}{cut}.{size[0]}x{size[1]}"


def _label(
    variant: Variant, frames: FrameSet, validation: FrameSet | None, wishes: RecipeConfig
) -> str:
    """Tells trainings apart; equal ones of several recipes have one label, and are one."""
    parts = [variant.method.replace(":", "."), frames.name]
    parts += [variant.raw] if variant.raw != "sensor" else []
    parts += [f"share-{variant.share:g}"] if variant.share != 1 else []
    parts += [f"{k}-{v.replace(',', '+')}" for k, v in sorted(variant.settings.items())]
    parts += [f"judged-by-{validation.name}"] if validation else []
    parts += [f"seed-{wishes.seed}"] if wishes.seed else []
    parts += [f"steps-{wishes.steps}"] if wishes.steps is not None else []
    return ".".join(parts)
