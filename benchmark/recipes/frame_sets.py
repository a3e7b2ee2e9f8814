"""Sets of frames for training and testing: simulated, or given by the user."""

from __future__ import annotations

import hashlib
import logging
import multiprocessing
from collections.abc import Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import msgspec

from benchmark.data.splits import get_split, open_split, where_to_get
from benchmark.recipes.recipe import BASE_SETS, Recipe, Scale
from std_toolkit.errors import ToolkitError, check_known
from std_toolkit.io.documents import read_document
from std_toolkit.jobs import JobOptions
from std_toolkit.jobs.runner import die_with_parent, inherit, inherited
from std_toolkit.log import log_to_stderr, logger
from std_toolkit.plugins import check_named
from std_toolkit.settings import Settings

if TYPE_CHECKING:
    from sensors.simulation.options import SimulationOptions

Part = Literal["train", "test"]
_PARTS = ("train", "val", "test")


@dataclass(frozen=True, kw_only=True)
class FrameSet:
    """Frames in the DREDS layout.

    Attributes:
        name: in names of files; other data have another name.
        root: folder of the set.
        split: of the benchmark, below `root`.
        options: what it is simulated with; None for a set that the user gives.
        seeds: of its scenes.
    """

    name: str
    root: Path
    split: str
    options: SimulationOptions | None = None
    seeds: tuple[int, ...] = ()

    @property
    def part(self) -> Part:
        """The part of the DREDS layout that is simulated."""
        return "test" if self.split.endswith("test") else "train"

    @property
    def frames(self) -> int:
        """How many there are, or will be."""
        if self.options is None:
            return len(open_split(self.split, self.root))
        return len(self.seeds) * self.options.views

    @property
    def origin(self) -> str:
        """Where its frames come from, for people."""
        if self.options is None:
            return f"from {self.root}"
        return f"simulated by std-sim: {self.size}"

    @property
    def is_simulated(self) -> bool:
        """Whether `std-sim` makes it or has made it."""
        from sensors.simulation.simulated_set import SET_FILE

        return self.options is not None or (self.root / SET_FILE).is_file()

    @property
    def size(self) -> str:
        """Scenes and views of a simulated set, for people."""
        assert self.options is not None
        scenes, views = len(self.seeds), self.options.views
        return f"{scenes} scene{'s' * (scenes != 1)} of {views} view{'s' * (views != 1)}"

    def missing(self) -> list[int]:
        """Scenes that are still to be simulated."""
        return [seed for seed, folder in self._folders().items() if not folder.is_dir()]

    def check_scenes(self) -> None:
        """Check that the folder holds no scene of other seeds: it would be trained on, too.

        Raises:
            ToolkitError: it does, maybe from a run of another size.
        """
        wanted = list(self._folders().values())
        folder = wanted[0].parent
        there = sorted(folder.iterdir()) if folder.is_dir() else []
        other = [p.name for p in there if p.name.isdigit() and p not in wanted]
        if other:
            raise ToolkitError(
                "scenes that are not of the set",
                path=folder,
                value=", ".join(other),
                hint="move them away, or choose another --out",
            )

    def _folders(self) -> dict[int, Path]:
        """Folders of the scenes by seed."""
        from sensors.output.dreds import scene_folder
        from sensors.simulation.simulated_set import scene_name

        return {seed: scene_folder(self.root, self.part, scene_name(seed)) for seed in self.seeds}

    def simulate(self, jobs: JobOptions) -> dict[str, str]:
        """Make the scenes that are not there yet; an error line for each that failed.

        Raises:
            ToolkitError: the folder holds another set or scenes of other seeds, the disk is full,
                or the simulator cannot run.
        """
        from sensors.simulation.simulated_set import SET_FILE, SetRecord

        self.check_scenes()
        record = self.root / SET_FILE
        is_whole = record.is_file() and not self.missing()
        if is_whole and read_document(record, SetRecord).options == self.options:
            logger.info("set %s: kept, %d frames", self.name, self.frames)
            return {}
        # In a process of its own: the tracer's libraries stay out of this one, which is going to
        # load torch.
        context = multiprocessing.get_context("spawn")
        with ProcessPoolExecutor(
            1, mp_context=context, initializer=_prepare, initargs=inherited()
        ) as pool:
            try:
                failed = pool.submit(_simulate, self, jobs).result()
            except BrokenProcessPool as error:
                raise ToolkitError(
                    "the simulating process died (killed, or out of memory)",
                    path=self.root,
                    hint="run the same command again to go on",
                ) from error
        return {f"scene {key}": error for key, error in failed.items()}


def _prepare(limits: Sequence[Settings], document: str | None) -> None:
    inherit(limits, document)
    log_to_stderr(logging.INFO)
    # A killed recipe must not go on simulating beside the one that is started next.
    die_with_parent()


def _simulate(frames: FrameSet, jobs: JobOptions) -> dict[str, str]:
    from sensors.simulation.simulated_set import simulate_set

    assert frames.options is not None
    report = simulate_set(frames.root, frames.options, frames.seeds, split=frames.part, jobs=jobs)
    return report.failed


def named_folders(
    texts: Sequence[str], known: Sequence[str], what: str, field: str | None = None
) -> list[tuple[str, Path]]:
    """Name, or "", and folder of texts `[NAME=]DIR`.

    Raises:
        ToolkitError: no such name or folder.
    """
    found = []
    for text in texts:
        name, equals, folder = text.partition("=")
        if not equals or Path(text).exists():  # a folder's own name may hold "="
            name, folder = "", text
        if name:
            problem = f"the recipe has no such {what}"
            check_known(name, known, problem, field=field, told="it has")
        if not Path(folder).is_dir():
            raise ToolkitError("no such folder", path=folder)
        found.append((name, Path(folder)))
    return found


def mark_of(root: Path) -> str:
    """Tells folders of the user apart in names of files."""
    return hashlib.sha256(str(root.resolve()).encode()).hexdigest()[:8]


def parse_given(texts: Sequence[str], usual: str, recipe: Recipe) -> dict[str, Path]:
    """Folders by set, of texts `[SET=]DIR`.

    Raises:
        ToolkitError: no such set or folder, or a set twice.
    """
    found: dict[str, Path] = {}
    for name, folder in named_folders(texts, (*BASE_SETS, *recipe.sets), "set"):
        if (name or usual) in found:
            raise ToolkitError("two folders for one set", field=name or usual, value=folder)
        found[name or usual] = folder
    return found


def given_set(name: str, root: Path, prefer: str) -> FrameSet:
    """A set of the user's.

    Args:
        name: of the set.
        root: a set of `std-sim`, or DREDS-CatKnown as published.
        prefer: part that is looked for first: `train`, `val` or `test`.

    Raises:
        ToolkitError: it holds no frames.
    """
    parts = sorted(_PARTS, key=lambda part: part != prefer)
    for part in parts:
        split = f"dreds-catknown-{part}"
        try:
            open_split(split, root)
        except ToolkitError:
            continue
        return FrameSet(name=f"{name}-{mark_of(root)}", root=root, split=split)
    raise ToolkitError(
        "no frames of a simulated set here",
        path=root,
        hint=where_to_get(get_split(f"dreds-catknown-{prefer}")),
    )


def plan_set(
    name: str, recipe: Recipe, scale: Scale, given: Mapping[str, Path], out: Path
) -> FrameSet:
    """A set by its name: the user's, or what is to be simulated.

    A set that differs from another in some options has the scenes of the other, also where that
    one is the user's.

    Raises:
        ToolkitError: options that there are not, or the user's set does not say how it was made.
    """
    from sensors.simulation.options import SimulationOptions

    derived = recipe.sets.get(name)
    base = derived.like if derived else name
    if name in given:
        return given_set(name, given[name], base)
    if base in given:
        return _alike(name, recipe, given_set(base, given[base], base), out)
    size = scale.sets[base]
    options = {**size.options, "split": size.split, **(derived.options if derived else {})}
    return FrameSet(
        name=name,
        root=out / "data" / name,
        split=f"dreds-catknown-{size.split}",
        options=_convert(options, SimulationOptions, name),
        seeds=tuple(range(size.seed, size.seed + size.scenes)),
    )


def _alike(name: str, recipe: Recipe, base: FrameSet, out: Path) -> FrameSet:
    """A set with the scenes of the user's, by other options."""
    from sensors.simulation.options import SimulationOptions
    from sensors.simulation.simulated_set import SET_FILE, SetRecord

    like, record = recipe.sets[name].like, base.root / SET_FILE
    hint = f"give this set, too: {name}=DIR"
    keys = open_split(base.split, base.root).keys()
    scenes = list(dict.fromkeys(key.scene for key in keys))
    if not record.is_file() or not all(scene.isdigit() for scene in scenes):
        raise ToolkitError(
            f"set {name} is to have the scenes of {like}, which was not made by std-sim",
            path=base.root,
            hint=hint,
        )
    made = msgspec.to_builtins(read_document(record, SetRecord).options)
    return FrameSet(
        name=f"{name}-{base.name.removeprefix(f'{like}-')}",
        root=out / "data" / f"{name}-{base.name.removeprefix(f'{like}-')}",
        split=f"dreds-catknown-{'test' if made['split'] == 'test' else 'train'}",
        options=_convert({**made, **recipe.sets[name].options}, SimulationOptions, name),
        seeds=tuple(int(scene) for scene in scenes),
    )


def _convert(options: Mapping[str, Any], type_: Any, name: str) -> Any:
    for field in ("assets", "matcher"):
        check_named(options.get(field), field=f"sets.{name}.options.{field}")
    try:
        return msgspec.convert(dict(options), type_)
    except msgspec.ValidationError as error:
        problem, _, at = str(error).partition(" - at `$")
        raise ToolkitError(problem, field=f"sets.{name}.options{at.strip('`')}") from error
