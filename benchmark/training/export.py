"""Export of trained weights: half precision, a digest and a model card.

Also gives the `std-bench` command that uses the weights.
"""

import hashlib
import math
import re
from collections.abc import Mapping, Sequence
from pathlib import Path

import torch
from safetensors.torch import save

from benchmark.methods.registry import grasp_planners, pose_methods, restorers
from benchmark.methods.weights import read_weights
from benchmark.metrics.depth import harm, holes
from benchmark.training.config import CONFIG, TrainConfig
from benchmark.training.run_files import BEST, BestScores, read_best, read_log
from benchmark.training.run_note import RUN_NOTE, PartNote, RunNote
from benchmark.training.step import BATCH_NORM_FRAMES
from std_toolkit import __version__
from std_toolkit.errors import ToolkitError
from std_toolkit.io.atomic import write_bytes_atomic
from std_toolkit.io.documents import read_document
from std_toolkit.jobs.door import has_record, own_files

_SHOWN_OPTIONS = (
    *("sensor", "views", "width", "height", "quality", "matcher", "materials", "depth"),
    "collision",
    "object_poses",
)

_MIB = 2**20

_NUMBER = re.compile(r"(\d+)")

_OF_DEPTH = "specular_transparent_"  # scores of restorers

_DECAYS = {"linear": "falling to 0", "steps": "falling by steps"}


def export_weights(run: Path, out: Path, *, scores: str = "") -> Path:
    """Write `<method>-<preset>.safetensors` in half precision, `.sha256` and `.md` beside it.

    Numbers too large or too small for half precision would become infinite or nothing: such
    tensors stay as they are.

    Args:
        run: folder of a training.
        out: where the files go; those of the same method and preset are replaced.
        scores: Markdown for the card's section of scores; see `std-report --format markdown`.

    Returns:
        The file of weights.

    Raises:
        ToolkitError: no training, one that has not come to its first validation, or weights that
            are not finite, changed or damaged.
    """
    config = read_document(run / CONFIG, TrainConfig)
    if not (run / BEST).is_file():
        raise ToolkitError(
            "the training has no weights yet: they are written after a validation",
            path=run,
            hint="run the same std-train command again to go on",
        )
    note = read_document(run / RUN_NOTE, RunNote)
    best = read_best(run)
    state = {
        name: half(tensor, name, run / BEST) for name, tensor in read_weights(run / BEST).items()
    }
    data = save(state)
    path, digest = out / f"{config.label}.safetensors", hashlib.sha256(data).hexdigest()
    size = len(data) / _MIB
    parameters = sum(t.numel() for t in state.values())
    lines = [
        f"# {config.method}, preset {config.preset}",
        "",
        f"Weights that `{bench_command(config.method)} --preset {config.preset}` uses. "
        f"{parameters / 1e6:.2f} million numbers in half precision, {size:.1f} MiB, "
        f"SHA-256 `{digest}`. Made by std-toolkit {__version__}; licence: Apache-2.0, as the "
        "toolkit's.",
        "",
        *_table("Trained on", _data(note.training)),
        *_table("Judged by (which weights are the best)", _data(note.validation)),
        *_table("How", _how(config, best, run, note)),
    ]
    known = {k: v for k, v in best.scores.items() if v is not None}
    named = {k: v for k, v in known.items() if k.startswith(_OF_DEPTH)}
    pixels = "specular and transparent pixels, at the size of training"
    lines += _table(
        f"Scores of validation, {pixels}" if named else "Scores of validation",
        [
            (name.removeprefix(_OF_DEPTH), f"{value:.4f}")
            for name, value in (named or known).items()
        ],
    )
    lines += _elsewhere(known)
    if scores:
        lines += ["## Scores on test sets", "", scores.rstrip(), ""]
    sums = path.with_name(path.name + ".sha256")
    card = path.with_suffix(".md")
    out.mkdir(parents=True, exist_ok=True)
    names = [p.name for p in (path, sums, card)]
    # Those of an earlier version, which kept no record, have their sum beside them.
    earlier = names if sums.is_file() and not has_record(out) else []
    with own_files(out, names, known=earlier):
        write_bytes_atomic(path, data)
        write_bytes_atomic(sums, f"{digest}  {path.name}\n".encode())
        write_bytes_atomic(card, "\n".join(lines).encode())
    return path


def _elsewhere(scores: Mapping[str, float]) -> list[str]:
    """What the network does to depth that was right, in validation."""
    columns = [c for c in (*harm.COLUMNS, *holes.COLUMNS) if c.name in scores]
    if not columns:
        return []
    rows = [(column.title, column.text(scores[column.name])) for column in columns]
    return _table("Scores of validation, depth that was right", rows)


def half(tensor: torch.Tensor, name: str, path: Path) -> torch.Tensor:
    """A tensor in half precision, or as it is where that would lose its size.

    Raises:
        ToolkitError: a number is not finite.
    """
    if not tensor.is_floating_point():
        return tensor.contiguous()
    if not torch.isfinite(tensor).all():
        raise ToolkitError("weights that are not finite", path=path, field=name)
    small = tensor.half()
    lost = torch.isinf(small).any() or ((small == 0) & (tensor != 0)).float().mean() > 0.01
    return tensor.contiguous() if lost else small.contiguous()


def _data(parts: Sequence[PartNote]) -> list[tuple[str, str]]:
    rows = []
    for part in parts:
        scenes = sorted(part.scenes, key=_by_number)
        rows.append(
            (
                part.split,
                f"{part.frames} frames of {len(scenes)} scenes "
                f"({scenes[0]} to {scenes[-1]}), packed at "
                f"{part.size[0]}x{part.size[1]}"
                + (f", colour {part.color}" if part.color != "none" else ""),
            )
        )
        if part.simulation:
            described = ", ".join(
                f"{k} {part.simulation[k]}" for k in _SHOWN_OPTIONS if k in part.simulation
            )
            rows.append(
                ("simulated by std-sim", f"{described}; scenes are named after their seeds")
            )
    return rows


def _by_number(name: str) -> list[tuple[int, str]]:
    """What sorts scene 9 before scene 10."""
    return [(int(part), "") if part.isdigit() else (-1, part) for part in _NUMBER.split(name)]


def _how(config: TrainConfig, best: BestScores, run: Path, note: RunNote) -> list[tuple[str, str]]:
    batch = config.optimization.batch_size
    rate = config.optimization.learning_rate
    frames = sum(part.frames for part in note.training)
    rows = [
        (
            "steps",
            f"{config.steps} of {batch} frames, {config.steps * batch / frames:.1f} times "
            f"through the data; best at {best.step}",
        ),
        (
            "optimizer",
            f"{config.optimization.optimizer}, {rate:g}, "
            f"{_DECAYS[config.optimization.decay]}, {config.precision}",
        ),
        ("seed", str(config.seed)),
        ("machine", ", ".join(f"{k}: {v}" for k, v in note.hardware.items())),
        ("torch", note.packages.get("torch", "")),
    ]
    if config.geometry:
        rows.append(("augmented", "frames turned, mirrored and enlarged, beside colour"))
    if config.object_dropout:
        rows.append(
            (
                "object-depth dropout",
                f"objects in {config.object_dropout:g} of the frames have no depth, that of the "
                "background, or the true one, drawn at every step",
            )
        )
    if config.copy_paste:
        share = config.copy_paste
        rows.append(("copy-paste", f"objects of another frame into {share:g} of the frames"))
    if config.clear_gone or config.clear_behind:
        rows.append(
            (
                "glass and metal",
                f"{config.clear_gone:g} of the objects without sensor depth, "
                f"{config.clear_behind:g} with that of what is behind, drawn at every step",
            )
        )
    if config.holes:
        rows.append(("holes anywhere", f"in {config.holes:g} of the frames"))
    if config.wrong_color:
        rows.append(
            (
                "wrong colour",
                f"noise or another frame's in {config.wrong_color:g} of the frames, answered by "
                "the continuation of the sensor's depth",
            )
        )
    if config.patterns:
        rows.append(("patterns on the background", f"in {config.patterns:g} of the frames"))
    if config.depth_noise:
        rows.append(("more noise of depth", f"in {config.depth_noise:g} of the frames"))
    if config.sizes:
        rows.append(("sizes", f"{', '.join(config.sizes)}: one a step, of a part of each frame"))
    if config.batch_norm == "recomputed":
        rows.append(("batch-norm statistics", f"recomputed over {BATCH_NORM_FRAMES} frames"))
    if config.beginning and not note.earlier:
        rows.append(("began with", f"{config.beginning} (hash of the file)"))
    for stage in note.earlier:
        sizes = ", ".join(sorted({f"{w}x{h}" for w, h in stage.sizes}))
        moved = ", turned, mirrored and enlarged" if stage.geometry else ""
        rows.append(
            (
                "before that",
                f"{stage.taken} of {stage.steps} steps of {stage.batch_size} frames of "
                f"{stage.frames} at {sizes}"
                f"{moved}, rate {stage.learning_rate:g}",
            )
        )
    if config.settings:
        rows.append(("settings", ", ".join(f"{k}={v}" for k, v in config.settings.items())))
    if config.loss:
        rows.append(("loss", ", ".join(f"{k}={v}" for k, v in config.loss.items())))
    hours, speed = _hours(run, batch)
    if not math.isnan(hours):
        rows.append(("time", f"{hours:.2f} h at {speed:.1f} samples/s"))
    return rows


def _hours(run: Path, batch: int) -> tuple[float, float]:
    """Hours that the steps took, and samples per second; NaN without a log."""
    path = run / "steps.csv"
    if not path.is_file():
        return math.nan, math.nan
    log = read_log(path, numbers=("step", "samples_per_s"))
    rows = [(int(row["step"]), float(row["samples_per_s"])) for row in log]
    before, seconds = 0, 0.0
    for step, speed in rows:
        seconds += (step - before) * batch / max(speed, 1e-9)
        before = step
    if not seconds:
        return math.nan, math.nan
    return seconds / 3600, before * batch / seconds


def _table(title: str, rows: Sequence[tuple[str, str]]) -> list[str]:
    return [f"## {title}", "", "| | |", "|---|---|", *(f"| {a} | {b} |" for a, b in rows), ""]


def bench_command(method: str) -> str:
    """The command and the name of a method, without its preset and weights.

    >>> bench_command("swindrnet"), bench_command("nocs")
    ('std-bench --method swindrnet', 'std-bench pose --method nocs')
    """
    if method not in restorers.names():
        if method in pose_methods.names():
            return f"std-bench pose --method {method}"
        if method in grasp_planners.names():
            return f"std-bench grasp --planner {method}"
    return f"std-bench --method {method}"
