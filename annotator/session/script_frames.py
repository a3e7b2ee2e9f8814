"""Frames in scripts: file names instead of ids, and the files of ids.

In a script an integer is always a frame id, because exported scripts have ids. A string names a
frame as on the command line.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import msgspec

from std_toolkit.errors import ToolkitError
from std_toolkit.scene.scene import Scene

_FIELDS = ("frame", "frames")


def with_frame_ids(steps: Any, scene: Scene, path: Path) -> Any:
    """Return the plain content of a script with frame names replaced by frame ids.

    Raises:
        ToolkitError: a name is not that of one frame; names its place, such as `[3].frame`.
    """

    def replaced(value: Any, place: str, is_frame: bool) -> Any:
        if isinstance(value, dict):
            return {
                key: replaced(item, f"{place}.{key}", key in _FIELDS) for key, item in value.items()
            }
        if isinstance(value, list):
            return [replaced(item, f"{place}[{i}]", is_frame) for i, item in enumerate(value)]
        if not (is_frame and isinstance(value, str)):
            return value
        try:
            return scene.find_frame(value).id
        except ToolkitError as error:
            raise ToolkitError(
                error.problem, path=path, field=place, value=value, hint=error.hint
            ) from error

    return replaced(steps, "", False)


def frames_of(step: msgspec.Struct) -> list[int]:
    """Return the ids of the frames that a step names, in order of first mention."""
    return list(dict.fromkeys(_ids(msgspec.to_builtins(step), False)))


def frame_or_name(schema: Any) -> Any:
    """Return a JSON Schema in which every frame id may also be a string."""
    if isinstance(schema, list):
        return [frame_or_name(item) for item in schema]
    if not isinstance(schema, dict):
        return schema
    result = {key: frame_or_name(item) for key, item in schema.items()}
    properties = result.get("properties")
    if isinstance(properties, dict):
        result["properties"] = {
            key: _with_string(item) if key in _FIELDS else item for key, item in properties.items()
        }
    return result


def _with_string(schema: dict[str, Any]) -> dict[str, Any]:
    if schema.get("type") == "integer":
        return {"anyOf": [schema, {"type": "string"}]}
    return {
        key: _with_string(item)
        if key == "items"
        else [_with_string(x) for x in item]
        if key == "anyOf"
        else item
        for key, item in schema.items()
    }


def _ids(value: Any, is_frame: bool) -> Iterator[int]:
    if isinstance(value, dict):
        for key, item in value.items():
            yield from _ids(item, key in _FIELDS)
    elif isinstance(value, Sequence) and not isinstance(value, str):
        for item in value:
            yield from _ids(item, is_frame)
    elif is_frame and isinstance(value, int):
        yield value
