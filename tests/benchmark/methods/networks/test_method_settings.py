"""Settings of methods: from text to configurations."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import pytest

from benchmark.methods.registry import preset_of
from std_toolkit.errors import ToolkitError
from std_toolkit.plugins import configured


@dataclass(frozen=True)
class Config:
    way: Literal["left", "right"] = "left"
    flag: bool = False
    count: int = 3
    share: float = 0.5
    window: int | None = 7
    size: tuple[int, int] = (1, 2)
    scales: tuple[float, ...] = (1.0,)
    name: str = "x"


def test_every_kind_of_field():
    settings = {
        "way": "right",
        "flag": "Yes",
        "count": " 5 ",
        "share": "1e-3",
        "window": "none",
        "size": "3, 4",
        "scales": "0.5,1,2",
        "name": "anything",
    }
    expected = Config("right", True, 5, 1e-3, None, (3, 4), (0.5, 1.0, 2.0), "anything")
    assert configured(Config(), settings) == expected
    assert configured(Config(), {"window": "9"}).window == 9
    assert configured(Config(), {}) == Config()


@pytest.mark.parametrize(
    ("settings", "told"),
    [
        ({"wya": "left"}, "no such setting"),
        ({"way": "up"}, "left, right"),
        ({"flag": "maybe"}, "true or false"),
        ({"count": "2.5"}, "whole number"),
        ({"share": "much"}, "a number"),
        ({"window": "big"}, "whole number"),
        ({"size": "3"}, "2 values"),
        ({"size": "3,x"}, "whole number"),
    ],
)
def test_wrong_settings(settings, told):
    with pytest.raises(ToolkitError, match=told) as caught:
        configured(Config(), settings)
    assert next(iter(settings)) in str(caught.value)


def test_presets():
    presets = {"published": Config(), "compact": Config(count=1)}
    assert preset_of(presets, "compact").count == 1
    with pytest.raises(ToolkitError, match="published, compact"):
        preset_of(presets, "huge")
