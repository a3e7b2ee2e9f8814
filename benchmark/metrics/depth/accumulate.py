"""Means of depth metrics over images, accumulated batch by batch."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmark.metrics.depth.depth_metrics import checked, depth_errors, image_errors
from benchmark.metrics.depth.figures import Errors, Missing, check_reportable, namespace
from std_toolkit.errors import ToolkitError

_NAMES = tuple(f.name for f in fields(Errors) if f.name not in ("n_pixels", "n_answered"))
_OF_ANSWERED = np.array([name.endswith("_answered") for name in _NAMES])


class DepthMetrics:
    """Unweighted means over images, as in all published tables.

    An image without any pixel to compare is in no mean. An image without any usable prediction is
    in all means except those over answered pixels.

    Args:
        missing: how pixels count whose prediction is not finite or not positive: `COUNTED` or
            `AS_GIVEN`.

    Raises:
        ToolkitError: `LEFT_OUT`, whose means are always available as `..._answered`.

    >>> metrics = DepthMetrics()
    >>> metrics.update(np.array([[[1.0, 0.0]]]), np.array([[[1.0, 2.0]]]))
    >>> metrics.update(np.ones((3, 1, 2)), np.ones((3, 1, 2)))
    >>> metrics.compute()["mae"], metrics.images
    (0.25, 4)
    """

    def __init__(self, missing: Missing = Missing.COUNTED) -> None:
        check_reportable(missing)
        self.missing = missing
        self._state = np.zeros(2 + len(_NAMES))

    @property
    def images(self) -> int:
        """Images that entered the means."""
        return int(self._state[0])

    @property
    def state(self) -> NDArray[np.float64]:
        """A copy of all that was taken up; states add, such as over the processes of a training.

        >>> DepthMetrics().state.sum()
        np.float64(0.0)
        """
        return self._state.copy()

    def update(self, pred: Any, true: Any, valid: Any | None = None) -> None:
        """Add images.

        Args:
            pred: (B, H, W) or (H, W) predicted metres; arrays of numpy, or tensors of torch.
            true: true metres, of that shape and kind.
            valid: which pixels to compare, bool, of that shape and kind; all by default.

        Raises:
            ToolkitError: shapes or types that do not belong together.

        >>> DepthMetrics().update(np.ones((2, 3, 3)), np.ones((2, 3, 3)))
        """
        if pred.ndim not in (2, 3):
            raise ToolkitError("must be (B, H, W) or (H, W)", field="pred", value=tuple(pred.shape))
        pred, true, valid = checked(pred, true, valid)
        if pred.ndim == 2:
            pred, true = pred[None], true[None]
            valid = None if valid is None else valid[None]
        if namespace(pred) is not np:
            found = image_errors(pred, true, valid, missing=self.missing)
            self._take({name: tensor.cpu().numpy() for name, tensor in found.items()})
            return
        for i in range(len(pred)):
            mask = None if valid is None else valid[i]
            self.add(depth_errors(pred[i], true[i], mask, missing=self.missing))

    def add(self, errors: Errors) -> None:
        """Add one image with known errors.

        Args:
            errors: of all its compared pixels.

        >>> metrics = DepthMetrics()
        >>> metrics.add(depth_errors(np.ones((2, 2)), np.ones((2, 2))))
        >>> metrics.images
        1
        """
        self._take({name: np.array([value]) for name, value in errors.as_dict().items()})

    def merge(self, other: DepthMetrics) -> None:
        """Add the images of another accumulator.

        Args:
            other: not changed.

        Raises:
            ToolkitError: it counts missing pixels differently.

        >>> one, two = DepthMetrics(), DepthMetrics()
        >>> two.update(np.ones((2, 2)), np.ones((2, 2)))
        >>> one.merge(two)
        >>> one.images
        1
        """
        if other.missing is not self.missing:
            raise ToolkitError(
                "counts missing pixels another way",
                field="missing",
                value=other.missing.value,
                hint=f"here they are {self.missing.value}",
            )
        self.merge_state(other._state)

    def merge_state(self, state: NDArray[np.float64]) -> None:
        """Add a `state`, or a sum of several.

        Args:
            state: as `state` gives it.

        Raises:
            ToolkitError: it is none.

        >>> metrics = DepthMetrics()
        >>> metrics.merge_state(metrics.state)
        """
        if state.shape != self._state.shape:
            raise ToolkitError("is not a state of DepthMetrics", value=state.shape)
        self._state += state

    def compute(self) -> dict[str, float]:
        """The means so far.

        Returns:
            Means by the names of `Errors`, NaN where no image has entered.

        >>> DepthMetrics().compute()["rmse"]
        nan
        """
        n, n_answered = self._state[:2]
        counts = np.where(_OF_ANSWERED, n_answered, n)
        with np.errstate(invalid="ignore"):
            means = self._state[2:] / counts
        return {name: float(mean) for name, mean in zip(_NAMES, means, strict=True)}

    def reset(self) -> None:
        """Remove all images.

        >>> metrics = DepthMetrics()
        >>> metrics.update(np.ones((2, 2)), np.ones((2, 2)))
        >>> metrics.reset()
        >>> metrics.images
        0
        """
        self._state[:] = 0

    def _take(self, errors: Mapping[str, NDArray[Any]]) -> None:
        there, answered = errors["n_pixels"] > 0, errors["n_answered"] > 0
        self._state[0] += there.sum()
        self._state[1] += answered.sum()
        for i, name in enumerate(_NAMES):
            # A NaN from a prediction taken as given must reach the mean; one from nothing must not.
            enters = answered if _OF_ANSWERED[i] else there
            self._state[2 + i] += errors[name][enters].sum()
