"""How large a recipe is run: scenes, views, image size, steps, size of the networks."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Literal

import msgspec

from benchmark.recipes.recipe import BASE_SETS, read_toml
from std_toolkit.errors import ToolkitError

_FILE = Path(__file__).with_name("scales.toml")


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
        steps, batch_size, learning_rate, geometry: as in `TrainWishes`.
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
    return read_toml(_FILE, dict[str, Scale])


def get_scale(name: str) -> Scale:
    """A scale by its name.

    Raises:
        ToolkitError: there is none.
    """
    known = scales()
    if name not in known:
        raise ToolkitError(
            "no such scale", field="--scale", value=name, hint=f"one of {', '.join(known)}"
        )
    return known[name]
