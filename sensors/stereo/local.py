"""The local matcher: the best sum of costs over a window, without any smoothness between pixels."""

from __future__ import annotations

import os
from typing import Any

from sensors.stereo.matcher import Disparity, Image, check_pair
from sensors.stereo.options import Backend, LocalMatcherOptions
from std_toolkit.errors import ToolkitError


class LocalMatcher:
    """Census or ZNCC, summed over a box; the least cost wins; checked and fitted to sub-pixels.

    Pixels are left without disparity where the winner is not unique, where the right image has
    another one, at the ends of the disparity range, and in small patches: much as the depth cameras
    themselves leave holes on what does not show the projected pattern.
    """

    def __init__(self, options: LocalMatcherOptions | None = None) -> None:
        self.options = options or LocalMatcherOptions()

    def match(self, left: Image, right: Image) -> Disparity:
        """See `StereoMatcher`.

        Raises:
            ToolkitError: not a pair of 8-bit grey images of one size, or the package of the chosen
                backend is not installed.
        """
        check_pair(left, right)
        options = self.options
        if options.backend is Backend.NUMBA:
            from sensors.stereo import numba_backend

            return numba_backend.match(left, right, options, options.threads or _cores())
        try:
            from sensors.stereo import torch_backend
        except ModuleNotFoundError as error:
            raise ToolkitError(
                f"the torch backend of the stereo matcher is not installed: {error}",
                hint="pip install 'std-toolkit[train]'",
            ) from error
        return torch_backend.match(left, right, options)


def local_matcher(**options: Any) -> LocalMatcher:
    """The plug-in: options of `LocalMatcherOptions` as keywords."""
    return LocalMatcher(LocalMatcherOptions(**options))


def _cores() -> int:
    return len(os.sched_getaffinity(0))
