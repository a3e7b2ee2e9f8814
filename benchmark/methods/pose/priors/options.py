"""Options of making shape priors; imports nothing heavy."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Literal

import msgspec

from std_toolkit.errors import ToolkitError, check_options
from std_toolkit.jobs.door import Writes

Count = Annotated[int, msgspec.Meta(ge=1)]


@dataclass(frozen=True, kw_only=True)
class PriorOptions:
    """How priors are made."""

    assets: str = "builtin"
    """builtin, shapenet, folder, or another asset source"""
    root: Path | None = None
    """folder of its files, of sources that read files"""
    unit: Literal["m", "cm", "mm"] | None = None
    """of the files, where they have real sizes"""
    split: Literal["train", "test", "all"] = "train"
    """which shapes; a fair prior does not know those of the test split"""
    categories: tuple[str, ...] | None = None
    """which categories (all but distractors)"""
    instances: Count = 50
    """most shapes of a category"""
    points: Count = 1024
    """of a prior"""
    how: Literal["autoencoder", "barycentre"] = "autoencoder"
    """mean embedding of an auto-encoder, as published for SPD, or mean by optimal transport, which
    needs no training"""
    epochs: Count = 50
    """of the auto-encoder"""
    seed: int = 0
    """of all that is drawn"""
    device: str = "cpu"
    """of the auto-encoder"""

    def __post_init__(self) -> None:
        check_options(self)


@dataclass(frozen=True, kw_only=True)
class PriorsCommand(PriorOptions):
    """Make the shape priors that spd and sgpa deform: the mean shape of every category of meshes.

    `std-train --set priors=FILE` trains with them; trained weights hold them.
    """

    out: Path = field(metadata={"option": "out", "writes": Writes("file")})
    """file to write, *.safetensors"""

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.out.suffix != ".safetensors":
            raise ToolkitError("priors are kept as *.safetensors", path=self.out)
