"""Evaluation protocols, and scoring by them."""

from benchmark.protocols.protocol import Grid, Protocol, Subset
from benchmark.protocols.registry import DEFAULT, get_protocol, protocols
from benchmark.protocols.score import Row, score_depth, score_frame, score_sensor

__all__ = [
    "DEFAULT",
    "Grid",
    "Protocol",
    "Row",
    "Subset",
    "get_protocol",
    "protocols",
    "score_depth",
    "score_frame",
    "score_sensor",
]
