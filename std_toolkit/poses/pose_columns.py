"""Names of the columns of camera poses, in a header or in a comment above the numbers."""

import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from std_toolkit.arrays import Array

QuaternionOrder = Literal["wxyz", "xyzw"]

_ROTATION = re.compile(r"(?:q|quat|quaternion|orientation)[_.]?(?:\w*[_.])?([wxyz])")
# Nanoseconds since 1970 have 19 digits from 2001 on.
NANOSECONDS = re.compile(r"\d{19}(\.\d*)?|\d\.\d+e\+?18", re.IGNORECASE)
_UNIT = re.compile(r"\[(.*?)\]|\((.*?)\)|(?<=[xyz])_(mm|cm|m|deg|rad)$", re.IGNORECASE)
_POSITION = re.compile(r"(?:p|t|pos|position|trans|translation)[_.]?(?:\w*[_.])?([xyz])")


def plain_columns(columns: Sequence[str]) -> list[str]:
    """Names in lower case, without units; `q_RS_w [], p_RS_R_x [m]` of EuRoC are `qw`, `x`.

    >>> plain_columns(["Name", "pos_x", "q_w"])
    ['name', 'x', 'qw']
    """
    names = [_UNIT.sub("", c).strip().lower() for c in columns]
    found = []
    for name in names:
        rotation, position = _ROTATION.fullmatch(name), _POSITION.fullmatch(name)
        new = f"q{rotation[1]}" if rotation else position[1] if position else name
        found.append(name if new != name and (new in names or new in found) else new)
    return found


def column_units(columns: Sequence[str]) -> list[str]:
    """The unit that each name states, in lower case; "" if it states none.

    >>> column_units(["x [mm]", "rx(deg)", "y_cm", "z"])
    ['mm', 'deg', 'cm', '']
    """
    found = (_UNIT.search(c.strip()) for c in columns)
    return [next(filter(None, m.groups()), "").strip().lower() if m else "" for m in found]


def columns_of_comment(text: str, width: int) -> list[str] | None:
    """The columns that the comments of a file name: a quaternion among `width` names; or None.

    >>> columns_of_comment("# timestamp tx ty tz qw qx qy qz", 8)
    ['timestamp', 'x', 'y', 'z', 'qw', 'qx', 'qy', 'qz']
    """
    for line in text.splitlines():
        if not line.lstrip().startswith(("#", "%", "//")):
            continue
        comment = re.sub(r"\[.*?\]|\(.*?\)", " ", line.strip()).lstrip("#%/ ")
        found = plain_columns([w for w in re.split(r"[\s,;]+", comment) if w])
        if len(found) == width and {"qw", "qx", "qy", "qz", "x", "y", "z"} <= set(found):
            return found
    return None


@dataclass(frozen=True)
class FiledOrder:
    """The order of quaternions in a file that does not name its columns.

    Attributes:
        order: as which they are read.
        why: what tells it; empty where nothing does.
    """

    order: QuaternionOrder
    why: str

    def sentence(self, order: QuaternionOrder | None = None) -> str:
        """How the quaternions are read, for the user; `order` is that of an option."""
        names = " ".join(f"q{c}" for c in order or self.order)
        why = "--cameras-quaternion" if order else self.why
        return f"its quaternions are read as {names} ({why})"


def filed_order(stamps: Sequence[str], values: Array, *, commas: bool) -> FiledOrder:
    """The order of quaternions beside time stamps.

    EuRoC and VINS write nanoseconds, commas and the real part first; TUM writes seconds, spaces
    and the real part last; ORB-SLAM3 writes nanoseconds with decimals in TUM's order.

    Args:
        stamps: first column, at least one.
        values: (N, 7) numbers beside it: position and quaternion.
        commas: whether commas part the columns.
    """
    if not all(map(NANOSECONDS.fullmatch, stamps)):
        return FiledOrder("xyzw", "as TUM files them")
    if commas:
        return FiledOrder("wxyz", "time stamps in nanoseconds and commas, as EuRoC has them")
    if all("." in s for s in stamps):
        return FiledOrder("xyzw", "nanoseconds with decimals and spaces, as ORB-SLAM3 has them")
    starts: dict[tuple[float, ...], QuaternionOrder] = {
        (0, 0, 0, 0, 0, 0, 1): "xyzw",
        (0, 0, 0, 1, 0, 0, 0): "wxyz",
    }
    first = starts.get(tuple(map(float, np.abs(values[0]))))
    return FiledOrder(first or "xyzw", "the first pose is then the identity" if first else "")


def euroc_rows(rows: list[tuple[int, list[str]]]) -> list[tuple[int, list[str]]]:
    """Rows of time stamps in nanoseconds, without the velocities and biases after the pose.

    VINS writes 11 columns and EuRoC 17. Rows of anything else are returned as they are, such as
    those of a name and the 16 numbers of a matrix, which end with 0 0 0 1.
    """
    width = len(rows[0][1])
    if width not in (11, 17) or not all(NANOSECONDS.fullmatch(words[0]) for _, words in rows):
        return rows
    if width == 17 and any(_is_last_row(words[13:]) for _, words in rows):
        return rows
    return [(i, words[:8]) for i, words in rows]


def _is_last_row(words: Sequence[str]) -> bool:
    try:
        return [float(w) for w in words] == [0, 0, 0, 1]
    except ValueError:
        return False


def without_frame_numbers(rows: list[tuple[int, list[str]]]) -> list[tuple[int, list[str]]]:
    """Rows, with their line numbers, without the three numbers before each matrix of a Redwood log.

    Rows of anything else are returned as they are.
    """
    is_log = len(rows) % 5 == 0 and all(
        len(words) == (3 if i % 5 == 0 else 4) for i, (_, words) in enumerate(rows)
    )
    return [row for i, row in enumerate(rows) if i % 5 != 0] if is_log else rows
