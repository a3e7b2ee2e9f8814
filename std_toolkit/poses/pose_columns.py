"""Names of the columns of camera poses, in a header or in a comment above the numbers."""

import re
from collections.abc import Sequence

_ROTATION = re.compile(r"(?:q|quat|quaternion|orientation)[_.]?(?:\w*[_.])?([wxyz])")
_POSITION = re.compile(r"(?:p|t|pos|position|trans|translation)[_.]?(?:\w*[_.])?([xyz])")


def plain_columns(columns: Sequence[str]) -> list[str]:
    """Names in lower case, without units; `q_RS_w [], p_RS_R_x [m]` of EuRoC are `qw`, `x`.

    >>> plain_columns(["Name", "pos_x", "q_w"])
    ['name', 'x', 'qw']
    """
    names = [re.sub(r"\[.*?\]|\(.*?\)", "", c).strip().lower() for c in columns]
    found = []
    for name in names:
        rotation, position = _ROTATION.fullmatch(name), _POSITION.fullmatch(name)
        new = f"q{rotation[1]}" if rotation else position[1] if position else name
        found.append(name if new != name and (new in names or new in found) else new)
    return found


def columns_of_comment(text: str, width: int) -> list[str] | None:
    """The columns that the comments of a file name: a quaternion among `width` names; or None.

    >>> columns_of_comment("# timestamp tx ty tz qw qx qy qz", 8)
    ['timestamp', 'x', 'y', 'z', 'qw', 'qx', 'qy', 'qz']
    """
    for line in text.splitlines():
        comment = re.sub(r"\[.*?\]|\(.*?\)", " ", line.strip()).lstrip("#%/ ")
        if not line.lstrip().startswith(("#", "%", "//")):
            continue
        found = plain_columns([w for w in re.split(r"[\s,;]+", comment) if w])
        if len(found) == width and {"qw", "qx", "qy", "qz", "x", "y", "z"} <= set(found):
            return found
    return None


def without_frame_numbers(rows: list[tuple[int, list[str]]]) -> list[tuple[int, list[str]]]:
    """Rows, with their line numbers, without the three numbers before each matrix of a Redwood log.

    Rows of anything else are returned as they are.
    """
    is_log = len(rows) % 5 == 0 and all(
        len(words) == (3 if i % 5 == 0 else 4) for i, (_, words) in enumerate(rows)
    )
    return [row for i, row in enumerate(rows) if i % 5 != 0] if is_log else rows
