"""Check of a split on disk: what exists, what is missing, and where to download it."""

from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from benchmark.data.splits import DepthSource, SceneFiles, Split, get_split
from std_toolkit.errors import ToolkitError

# Number of missing files, and of damaged frames, that are named.
_NAMED = 3
# Frames that are read, spread over the split: enough to detect a wrong size or unit.
_TRIED = 5


@dataclass(frozen=True)
class SplitReport:
    """Result of `check_split`.

    Attributes:
        split: the split.
        root: folder that was searched.
        scenes: existing and missing files of each scene; empty if nothing was found.
        problem: why nothing was found, else "".
        sizes: sizes (width, height) of the frames that were read, by "colour", "raw depth",
            "ground truth".
        unreadable: error lines of frames that could not be read.
        notes: comparison of the counts with the published ones.
    """

    split: Split
    root: Path
    scenes: tuple[SceneFiles, ...] = ()
    problem: str = ""
    sizes: dict[str, tuple[tuple[int, int], ...]] = field(default_factory=dict)
    unreadable: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()

    @property
    def frames(self) -> int:
        """Number of frames found, including incomplete ones."""
        return sum(s.frames for s in self.scenes)

    @property
    def missing(self) -> dict[str, list[str]]:
        """Missing files as scene/name, by content."""
        found: dict[str, list[str]] = {}
        for scene in self.scenes:
            for what, names in scene.missing.items():
                found.setdefault(what, []).extend(f"{scene.scene}/{name}" for name in names)
        return found

    @property
    def is_complete(self) -> bool:
        """Whether there are frames, all have their files, and the tested ones could be read."""
        return self.frames > 0 and not self.missing and not self.unreadable

    def record(self) -> dict[str, Any]:
        """Return the result as plain values."""
        return {
            "split": self.split.name,
            "root": str(self.root),
            "complete": self.is_complete,
            "problem": self.problem,
            "scenes": len(self.scenes),
            "frames": self.frames,
            "missing": self.missing,
            "unreadable": self.unreadable,
            "notes": self.notes,
            "about": self.split.card,
        }

    def text(self) -> str:
        """Return the result as lines for a terminal."""
        lines = [f"{self.split.name}: {self.split.about}", f"  looked in {self.root}"]
        if not self.scenes:
            lines.append(f"  nothing found: {self.problem}")
        else:
            lines += self._found()
        lines += [f"  {note}" for note in self.notes]
        lines += [f"  about: {line}" for line in self.split.card]
        if not self.is_complete:
            lines.append(f"  expected: {self.split.layout}")
            lines += [f"  page: {self.split.page}"] if self.split.page else []
            lines += [f"  download: {address}" for address in self.split.download]
        return "\n".join(lines)

    def _found(self) -> list[str]:
        counts = Counter(s.frames for s in self.scenes)
        usual, scenes = counts.most_common(1)[0]
        many = "" if len(self.scenes) == 1 else "s"
        lines = [f"  {self.frames} frames in {len(self.scenes)} scene{many}"]
        if len(counts) == 1 and many:
            lines[-1] += f", {usual} each"
        elif many:
            others = [s for s in self.scenes if s.frames != usual]
            odd = ", ".join(f"{s.scene} {s.frames}" for s in others[:_NAMED])
            more = ", ..." if len(others) > _NAMED else ""
            lines[-1] += f": {usual} in {scenes} of them; {odd}{more}"
        for what, sizes in self.sizes.items():
            lines.append(f"  {what}: " + ", ".join(f"{w}x{h}" for w, h in sizes))
        for what, names in self.missing.items():
            more = ", ..." if len(names) > _NAMED else ""
            named = ", ".join(names[:_NAMED])
            lines.append(f"  no {what}: {len(names)} of the frames, as {named}{more}")
        return lines + [f"  cannot be read: {text}" for text in self.unreadable]


def check_split(root: Path | str, name: str) -> SplitReport:
    """Check a split on disk before it is used.

    Lists every folder, and reads a few frames spread over the split.

    Args:
        root: folder of the data set, as for `open_split`.
        name: name of the split.

    Raises:
        ToolkitError: unknown split.
    """
    split, root = get_split(name), Path(root)
    if not root.is_dir():
        return SplitReport(split, root, problem="no such folder")
    try:
        source = split.open(root)
        scenes = tuple(source.files())
    except ToolkitError as error:
        return SplitReport(split, root, problem=str(error.revised(hint=None)))
    sizes, unreadable = _try_frames(source)
    frames = sum(s.frames for s in scenes)
    return SplitReport(
        split,
        root,
        scenes,
        sizes=sizes,
        unreadable=unreadable,
        notes=(*_compare(split, frames, len(scenes)), *_own_notes(source)),
    )


def _try_frames(
    source: DepthSource,
) -> tuple[dict[str, tuple[tuple[int, int], ...]], tuple[str, ...]]:
    sizes: dict[str, set[tuple[int, int]]] = {}
    unreadable = []
    steps = max(1, (len(source) - 1) // max(1, _TRIED - 1))
    for index in range(0, len(source), steps):
        try:
            frame = source.load(index)
        except ToolkitError as error:
            # Missing files are reported separately.
            if error.path is None or Path(error.path).exists():
                unreadable.append(str(error))
            continue
        for what, image in (
            ("colour", frame.color),
            ("raw depth", frame.depth_raw),
            ("ground truth", frame.depth_true),
        ):
            sizes.setdefault(what, set()).add((image.shape[1], image.shape[0]))
    return {k: tuple(sorted(v)) for k, v in sizes.items()}, tuple(unreadable[:_NAMED])


def _own_notes(source: DepthSource) -> tuple[str, ...]:
    """What the counts of the data set itself say of the frames."""
    notes = getattr(source, "notes", None)
    return () if notes is None else tuple(notes())


def _compare(split: Split, frames: int, scenes: int) -> tuple[str, ...]:
    """Notes that compare the number of frames with the published ones."""
    notes = []
    for said in split.published:
        counted = f"{said.frames} frames" + (f" in {said.scenes} scenes" if said.scenes else "")
        if said.of_more:
            fits = f"{said.of_more} together"
        else:
            fits = "as found" if frames == said.frames else f"{frames - said.frames:+d} here"
        notes.append(f"published by the {said.source}: {counted} ({fits})")
    if len({said.frames for said in split.published}) > 1:
        notes.append(
            "the published counts contradict each other: which frames the published results are "
            "of is not known"
        )
    own = [said.frames for said in split.published if not said.of_more]
    if own and scenes and frames < min(own):
        notes.append("fewer than any published count: is the download complete?")
    return tuple(notes)
