"""The grid and the pixels of TransCG's evaluation."""

from benchmark.data.frame import Material
from benchmark.metrics.missing import Missing
from benchmark.protocols.protocol import Grid, Protocol, Subset

TRANSCG = Protocol(
    name="transcg",
    about="320x240, transparent objects 0.3 to 1.5 m away, as TransCG and DFNet compare",
    grids=(Grid("h240w320", (320, 240)),),
    subsets=(Subset("transparent", frozenset({Material.TRANSPARENT})),),
    missing=Missing.COUNTED,
    depth_range=(0.3, 1.5),
)
