"""Prior files: safetensors with (p, 3) float32 points for each category."""

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from benchmark.methods.registry import check_shipped
from std_toolkit.errors import ToolkitError
from std_toolkit.io.atomic import write_bytes_atomic

Floats = NDArray[np.float32]

FORMAT = "std-priors-1"
BUILTIN = "builtin"
_ABOUT = "priors"
_BUILTIN_FILE = Path(__file__).resolve().parent / "builtin.safetensors"
# A mean of shapes with a diagonal of 1 stays within the cube that they are in.
_FARTHEST = 1.0


@dataclass(frozen=True, eq=False)
class Priors:
    """Mean shapes.

    Attributes:
        points: (p, 3) of each category, p the same for all; in the canonical frame of NOCS, the
            middle at 0, a diagonal of about 1, y up.
        about: how they were made, as text by name.

    Raises:
        ToolkitError: no category, other shapes, or numbers that are not finite or not normalised.
    """

    points: Mapping[str, Floats]
    about: Mapping[str, str] = field(default_factory=dict)

    def __post_init__(self) -> None:
        sizes = {p.shape for p in self.points.values()}
        if len(sizes) != 1 or len(next(iter(sizes))) != 2 or next(iter(sizes))[1] != 3:
            raise ToolkitError("priors must be (p, 3) points, p the same for all", value=sizes)
        for name, points in self.points.items():
            if not (np.isfinite(points).all() and np.abs(points).max() <= _FARTHEST):
                raise ToolkitError(
                    "must be finite, in the canonical frame with a diagonal of 1",
                    field=name,
                )

    def of(self, categories: Sequence[str]) -> Floats:
        """(c, p, 3) points of these categories, in their order.

        Raises:
            ToolkitError: there is none of a category.
        """
        for name in categories:
            if name not in self.points:
                raise ToolkitError(
                    "there is no prior of this category",
                    value=name,
                    hint=f"there are {', '.join(self.points)}; `std-bench priors` makes others",
                )
        return np.stack([self.points[name] for name in categories]).astype(np.float32)


def save_priors(path: Path, priors: Priors) -> None:
    """Write priors, atomically.

    Raises:
        ToolkitError: the file cannot be written, or is not called *.safetensors.
    """
    from safetensors.numpy import save

    if path.suffix != ".safetensors":
        raise ToolkitError("priors are kept as *.safetensors", path=path)
    points = {name: np.ascontiguousarray(p, np.float32) for name, p in priors.points.items()}
    # One entry: several would be in another order every time, and the file another.
    about = json.dumps({**priors.about, "format": FORMAT}, sort_keys=True)
    write_bytes_atomic(path, save(points, metadata={_ABOUT: about}))


def load_priors(path: Path | str) -> Priors:
    """Read priors; `builtin` for those that come with the toolkit, whose SHA-256 is checked.

    Raises:
        ToolkitError: no such file, not priors, or not the priors that were shipped.
    """
    from safetensors import SafetensorError, safe_open

    shipped = str(path) == BUILTIN
    path = _BUILTIN_FILE if shipped else Path(path)
    if not path.is_file():
        raise ToolkitError("no such file of priors", path=path)
    if shipped:
        check_shipped(path, "priors")
    try:
        with safe_open(path, framework="np") as file:
            about = json.loads((file.metadata() or {}).get(_ABOUT, "{}"))
            points = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118
    except (SafetensorError, OSError, TypeError, ValueError) as error:
        raise ToolkitError(f"not a file of safetensors: {error}", path=path) from error
    if not isinstance(about, dict) or about.pop("format", None) != FORMAT:
        raise ToolkitError("not a file of priors", path=path, hint="`std-bench priors` makes one")
    try:
        return Priors(points, about)
    except ToolkitError as error:
        raise error.revised(path=path) from error
