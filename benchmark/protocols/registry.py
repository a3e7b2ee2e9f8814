"""Which protocols there are."""

from __future__ import annotations

from benchmark.protocols.protocol import Protocol
from std_toolkit.errors import ToolkitError
from std_toolkit.plugins import Registry

DEFAULT = "strict"

protocols: Registry[Protocol] = Registry(
    "std_toolkit.depth_protocols",
    {
        "strict": "benchmark.protocols.strict:STRICT",
        "paper": "benchmark.protocols.paper:PAPER",
        "cleargrasp": "benchmark.protocols.cleargrasp:CLEARGRASP",
        "transcg": "benchmark.protocols.transcg:TRANSCG",
    },
)


def get_protocol(name: str = DEFAULT) -> Protocol:
    """A protocol by its name, or by `package.module:ATTRIBUTE`.

    Args:
        name: one of `protocols.names()`, of an installed plug-in, or a path to one.

    Returns:
        The protocol.

    Raises:
        ToolkitError: no such protocol, or what stands there is none.

    >>> get_protocol().main
    ('h126w224', 'all')
    """
    found = protocols.get(name)
    if not isinstance(found, Protocol):
        raise ToolkitError("is not a Protocol", field=name, value=type(found).__name__)
    return found
