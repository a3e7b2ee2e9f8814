"""Methods of a run: told at once if they cannot be used, and named by the hash of their weights."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

from benchmark.methods.registry import MethodOptions
from benchmark.methods.shipped import shipped_file
from benchmark.running.device import check_device
from std_toolkit.errors import ToolkitError
from std_toolkit.scene.provenance import digest_file


class UnusableMethod(ToolkitError):
    """A method that cannot be made with these options, whatever the data."""


@contextmanager
def making_methods(devices: Sequence[str]) -> Iterator[None]:
    """What goes wrong while methods are made on these devices is an `UnusableMethod`.

    Raises:
        UnusableMethod: a device that there is not, or what a method says of its options.
    """
    try:
        for device in devices:
            check_device(device)
        yield
    except ToolkitError as error:
        raise UnusableMethod(
            error.problem, path=error.path, field=error.field, value=error.value, hint=error.hint
        ) from error


def weights_digest(name: str, method: object, options: MethodOptions) -> str:
    """SHA-256 of the file of weights that a method uses, a user's or one that comes along; empty
    where there is none.

    Args:
        name: of the method.
        method: the method itself; None where there is none, as of raw depth.
        options: what it was made with.
    """
    if method is None:
        return ""
    # A method of somebody's own may use the file without telling.
    weights = getattr(method, "weights", None) or options.weights
    if weights is None and (shipped := shipped_file(name, options.preset)).is_file():
        weights = shipped
    return digest_file(weights) if isinstance(weights, Path) else ""
