"""Evaluation protocols, and scoring by them."""

from benchmark.metrics.protocols.protocol import (
    DEFAULT,
    Grid,
    Protocol,
    Subset,
    get_protocol,
    protocols,
)
from benchmark.metrics.protocols.score import Row, score_depth, score_frame, score_sensor

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
