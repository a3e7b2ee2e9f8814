"""Priors from meshes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from benchmark.pose_methods.priors.file import Priors
from benchmark.pose_methods.priors.shapes import Shapes, sample_shapes
from std_toolkit.errors import ToolkitError
from std_toolkit.log import logger

How = Literal["autoencoder", "barycentre"]
Split = Literal["train", "test", "all"]
_OTHER = "other"


@dataclass(frozen=True, kw_only=True)
class PriorOptions:
    """How priors are made.

    Attributes:
        assets: `builtin`, `shapenet`, `folder`, or another source of `sensors.assets`.
        root, unit: where its files are and what their unit is, for sources that read files.
        split: shapes of which split; those of the test split should not be known.
        categories: None for all but distractors.
        instances: shapes of each category, at most.
        points: of a prior.
        how: `autoencoder` as published for SPD; `barycentre` needs no training.
        epochs: of the auto-encoder.
        seed: of all that is drawn.
        device: of the auto-encoder.
    """

    assets: str = "builtin"
    root: Path | None = None
    unit: str | None = None
    split: Split = "train"
    categories: tuple[str, ...] | None = None
    instances: int = 50
    points: int = 1024
    how: How = "autoencoder"
    epochs: int = 50
    seed: int = 0
    device: str = "cpu"

    def __post_init__(self) -> None:
        for name in ("instances", "points", "epochs"):
            if getattr(self, name) < 1:
                raise ToolkitError("must be at least 1", field=name, value=getattr(self, name))


def make_priors(options: PriorOptions | None = None) -> Priors:
    """The mean shape of every category.

    Raises:
        ToolkitError: no such assets or categories.
    """
    options = options or PriorOptions()
    shapes = read_shapes(options)
    about = {
        "assets": options.assets,
        "split": options.split,
        "how": options.how,
        "seed": str(options.seed),
        "instances": ", ".join(f"{name} {len(found.ids)}" for name, found in shapes.items()),
    }
    points = {name: found.points for name, found in shapes.items()}
    if options.how == "barycentre":
        from benchmark.pose_methods.priors.barycentre import barycentre

        return Priors({name: barycentre(some) for name, some in points.items()}, about)
    from benchmark.pose_methods.priors.autoencoder import AutoencoderOptions, mean_shapes

    found = mean_shapes(
        points,
        AutoencoderOptions(
            points=options.points, epochs=options.epochs, seed=options.seed, device=options.device
        ),
        lambda epoch, loss: logger.info("epoch %d: chamfer distance %.6f", epoch + 1, loss),
    )
    return Priors(found, {**about, "epochs": str(options.epochs)})


def read_shapes(options: PriorOptions) -> dict[str, Shapes]:
    """Points on the shapes of every category that priors are made of.

    Raises:
        ToolkitError: no such assets or categories.
    """
    from sensors.assets import SourceOptions, open_source

    name = "procedural" if options.assets == "builtin" else options.assets
    source = open_source(
        name, SourceOptions(root=options.root, split=options.split, unit=options.unit)
    )
    categories: Sequence[str] = options.categories or [
        category for category in source.categories() if category != _OTHER
    ]
    shapes = {}
    for category in categories:
        shapes[category] = sample_shapes(
            source,
            category,
            instances=options.instances,
            points=options.points,
            seed=options.seed,
        )
        logger.info("%s: %d shapes", category, len(shapes[category].ids))
    return shapes
