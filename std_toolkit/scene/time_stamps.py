"""Time stamps that files state as text, in seconds."""

import re
from collections.abc import Sequence

_NUMBER = re.compile(r"\d+(\.\d*)?|\d\.\d+e\+?(09|12|15|18)", re.IGNORECASE)
# Whole digits of the time since 1970 in another unit than seconds, from 2001 on.
_UNITS = {13: 1e-3, 16: 1e-6, 19: 1e-9}
_SECONDS_DIGITS = (9, 10)


def stamps_of(texts: Sequence[str], *, stated: bool = False) -> list[float]:
    """Seconds of each text; NaN for all unless they are time stamps of one kind.

    Time stamps are seconds with decimals, of which some may be whole, or the time since 1970 in
    seconds, milliseconds, microseconds or nanoseconds. Other whole numbers, and those with leading
    zeros, are indices.

    Args:
        texts: such as the names of images without their suffix, or a column.
        stated: whether a header calls them times, so that any number of seconds is one.

    >>> stamps_of(["1305031102", "1305031102.5"])
    [1305031102.0, 1305031102.5]
    >>> stamps_of(["1305031102000000000"])
    [1305031102.0]
    >>> stamps_of(["7", "8"])
    [nan, nan]
    """
    none = [float("nan")] * len(texts)
    words = [t.strip() for t in texts]
    if not words or not all(map(_NUMBER.fullmatch, words)):
        return none
    values = [float(w) for w in words]
    units = {_UNITS.get(len(str(int(v))), 1.0) for v in values}
    if len(units) > 1:
        return none
    unit = units.pop()
    is_time = (
        stated
        or unit != 1
        or any("." in w for w in words)
        or all(len(str(int(v))) in _SECONDS_DIGITS for v in values)
    )
    if not is_time or (
        not stated and any(len(w) > 1 and w[0] == "0" and w[1] != "." for w in words)
    ):
        return none
    return [v * unit for v in values]
