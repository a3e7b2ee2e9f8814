"""Plans the steps of a recipe from its scale and the user's data."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from msgspec.structs import asdict

from benchmark.evaluation.depth_choice import DepthChoice
from benchmark.evaluation.tasks.depth import Run
from benchmark.evaluation.tasks.pose import PoseRun
from benchmark.methods.registry import MethodOptions, make_restorer
from benchmark.metrics.pose.pose_protocol import get_pose_protocol
from benchmark.metrics.protocols.protocol import get_protocol
from benchmark.published.load import published_table
from benchmark.recipes.frame_sets import FrameSet, given_set, mark_of, parse_given, plan_set
from benchmark.recipes.recipe import (
    POSE_DEPTHS,
    PoseVariant,
    Printed,
    Recipe,
    RecipeConfig,
    Scale,
    Variant,
    get_scale,
    load_recipe,
)
from benchmark.recipes.targets import Target, find_targets
from benchmark.training.options import PackOptions
from benchmark.training.run_files import BEST
from std_toolkit.errors import ToolkitError, check_known

if TYPE_CHECKING:
    from benchmark.training.options import TrainOptions


@dataclass(frozen=True, kw_only=True)
class Pack:
    """Frames of a set at the size of a network."""

    folder: Path
    frames: FrameSet
    size: tuple[int, int]
    raw: Literal["sensor", "cut"]
    nocs: bool = False


@dataclass(frozen=True, kw_only=True)
class Entry:
    """What is scored: a variant with its training, or a method without learning.

    Attributes:
        name: in the recipe.
        title: in tables.
        label: in names of files; the same training has the same in every recipe.
        method, preset, settings: of the restorer or the pose network.
        published: the printed row beside it.
        packs: that it is trained on, and judged by where those are others.
        training: its options, and `folder` of it; None without learning.
        pose: of a pose network, what it rests on.
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
    training: TrainOptions | None = None
    folder: Path | None = None
    pose: PoseVariant | None = None
    problem: str = ""

    @property
    def options(self) -> MethodOptions:
        """Its preset, settings and trained weights."""
        weights = None if self.folder is None else self.folder / BEST
        return MethodOptions(preset=self.preset, weights=weights, settings=self.settings)


@dataclass(frozen=True, kw_only=True)
class RecipePlan:
    """All steps.

    Attributes:
        name, recipe, scale_name, scale: what is run.
        folder: of the page.
        sets: that are needed, by name.
        packs: that are needed, each once.
        entries: methods without learning first.
        poses: pose networks, by name.
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
    poses: Mapping[str, Entry] = field(default_factory=dict)

    def place(self, target: Target) -> tuple[str, Path, str] | None:
        """Split and folder of a test and the name of its results; None if it is not available."""
        if target.set:
            frames = self.sets[target.set]
            return frames.split, frames.root, f"simulated-{frames.name}"
        if target.root is None:
            return None
        return target.split, target.root, f"{target.name}-{mark_of(target.root)}"

    def runs(self, entry: Entry, target: Target) -> list[Run | PoseRun]:
        """Scores of an entry on a test; none if the test is not available."""
        place = self.place(target)
        if place is None:
            return []
        split, root, name = place
        out = self.out / "results" / name
        common: dict[str, Any] = {
            "split": split,
            "root": root,
            "method": entry.method,
            "options": entry.options,
            "label": entry.label,
            "devices": self.devices if entry.folder else ("cpu",),
            "limit": self.scale.limit,
        }
        if entry.pose is None:
            protocols = self.recipe.protocols
            return [Run(**common, out=out, protocol=p, speed=False) for p in protocols]
        depth = folder = entry.pose.depth
        choice = DepthChoice(name=depth)
        if depth not in POSE_DEPTHS:
            restorer = next(e for e in self.entries if e.name == depth)
            choice = DepthChoice(name=restorer.method, options=restorer.options)
            folder = restorer.label
        out = out / f"depth-{folder}"
        return [PoseRun(**common, out=out, depth=choice, fit=entry.pose.fit)]


def plan_recipe(config: RecipeConfig) -> RecipePlan:
    """Everything that is to be done; nothing is made yet.

    A variant that cannot be trained here is in the plan with its problem.

    Raises:
        ToolkitError: no such recipe, scale, variant, set, test or folder.
    """
    name, recipe = load_recipe(config.recipe)
    scale = get_scale(config.scale)
    if recipe.table:
        published_table(recipe.table)  # fail on a wrong name before any work
    for protocol in recipe.protocols:
        get_protocol(protocol)  # likewise
    if recipe.poses:
        for protocol in recipe.pose_protocols:
            get_pose_protocol(protocol)
    for variant in config.only:
        problem = "the recipe has no such variant"
        check_known(variant, recipe.variants, problem, field="--only", told="it has")
    out = config.out / config.scale
    train = parse_given(config.train_data, "train", recipe)
    test = parse_given(config.test_data, "test", recipe)
    if twice := train.keys() & test.keys():
        raise ToolkitError("two folders for one set", value=min(twice))
    given = train | test
    judged_by = config.validation_data
    validation = None if judged_by is None else given_set("validation", judged_by, "val")
    targets = find_targets(recipe, config.data)
    variants = {k: v for k, v in recipe.variants.items() if not config.only or k in config.only}
    wanted = {k: p for k, p in recipe.poses.items() if p.depth in (*POSE_DEPTHS, *variants)}
    needed = [v.set for v in variants.values()] + [p.set for p in wanted.values()]
    needed += [t.set for t in targets if t.set]
    for one in recipe.sets:  # also where no variant uses it now
        plan_set(one, recipe, scale, {}, out)
    sets = {one: plan_set(one, recipe, scale, given, out) for one in dict.fromkeys(needed)}
    if unused := [one for one in given if one not in sets and one not in _likes(recipe, sets)]:
        raise ToolkitError("the recipe has no use for this set", value=unused[0])
    for method in recipe.baselines:
        make_restorer(method)  # fail on a wrong name before any work
    baselines = [
        Entry(name=method, title=method, label=method.replace(":", "."), method=method)
        for method in recipe.baselines
    ]
    trained, poses = (
        {k: _entry(k, v, config, scale, sets[v.set], validation, out) for k, v in chosen.items()}
        for chosen in (variants, wanted)
    )
    usable = [e for e in (*trained.values(), *poses.values()) if not e.problem]
    packs = {pack.folder: pack for entry in usable for pack in entry.packs}
    used = {pack.frames.name for pack in packs.values()}
    used |= {sets[t.set].name for t in targets if t.set}
    extra = "" if not config.seed else f".seed-{config.seed}"
    extra += "" if config.steps is None else f".steps-{config.steps}"
    return RecipePlan(
        name=name,
        recipe=recipe,
        scale_name=config.scale,
        scale=scale,
        folder=out / f"{name}{extra}",
        sets={key: frames for key, frames in sets.items() if frames.name in used},
        packs=list(packs.values()),
        entries=[*baselines, *trained.values()],
        targets=[_with_reason(target, recipe, sets) for target in targets],
        out=out,
        devices=config.devices,
        poses=poses,
    )


def _with_reason(target: Target, recipe: Recipe, sets: Mapping[str, FrameSet]) -> Target:
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
    config: RecipeConfig,
    scale: Scale,
    frames: FrameSet,
    validation: FrameSet | None,
    out: Path,
) -> Entry:
    from benchmark.training.catalogue import get_trainable
    from benchmark.training.options import TrainOptions

    pose = variant if isinstance(variant, PoseVariant) else None
    nocs = pose is not None
    planned = Entry(
        name=name,
        title=variant.title,
        label=_label(variant, frames, validation, config),
        method=variant.method,
        preset=scale.preset,
        published=variant.published,
        pose=pose,
    )
    how = scale.of(variant.method)
    try:
        trainable = get_trainable(variant.method)
        settings = trainable.settings_of(scale.preset, {**how.settings, **variant.settings})
        size = tuple(trainable.config(scale.preset, settings).input_size)
        PackOptions(size=size)  # fails on a size that cannot be packed
    except ToolkitError as error:
        return replace(planned, problem=f"cannot be trained here: {error}")
    packs = [
        Pack(
            folder=out / "packs" / _pack_name(one, size, variant.raw, nocs=nocs),
            frames=one,
            size=size,
            raw=variant.raw,
            nocs=nocs,
        )
        for one in (frames, validation)
        if one is not None
    ]
    own = {k: v for k, v in asdict(how).items() if v is not None}
    own |= {} if config.steps is None else {"steps": config.steps}
    training = TrainOptions(
        **own | {"settings": {**how.settings, **variant.settings}},
        method=variant.method,
        preset=scale.preset,
        data=(packs[0].folder,),
        validation=tuple(pack.folder for pack in packs[1:]),
        hold_out=scale.hold_out,
        share=variant.share,
        precision=config.precision,
        seed=config.seed,
    )
    return replace(
        planned,
        settings=settings,
        packs=tuple(packs),
        training=training,
        folder=out / "training" / planned.label,
    )


def _pack_name(frames: FrameSet, size: tuple[int, int], raw: str, *, nocs: bool) -> str:
    cut = "" if raw == "sensor" else f".{raw}"
    return f"{frames.name}{cut}{'.nocs' if nocs else ''}.{size[0]}x{size[1]}"


def _label(
    variant: Variant, frames: FrameSet, validation: FrameSet | None, config: RecipeConfig
) -> str:
    """Tells trainings apart; equal ones of several recipes have one label, and are one."""
    parts = [variant.method.replace(":", "."), frames.name]
    parts += [variant.raw] if variant.raw != "sensor" else []
    parts += [f"share-{variant.share:g}"] if variant.share != 1 else []
    parts += [f"{k}-{v.replace(',', '+')}" for k, v in sorted(variant.settings.items())]
    parts += [f"judged-by-{validation.name}"] if validation else []
    parts += [f"seed-{config.seed}"] if config.seed else []
    parts += [f"steps-{config.steps}"] if config.steps is not None else []
    return ".".join(parts)
