"""The grid and the pixels of ClearGrasp's evaluation."""

from benchmark.data.frame import Material
from benchmark.metrics.missing import Missing
from benchmark.protocols.protocol import Grid, Protocol, Subset

CLEARGRASP = Protocol(
    name="cleargrasp",
    about="256x144, transparent objects with ground truth, as ClearGrasp and LIDF compare",
    grids=(Grid("h144w256", (256, 144)),),
    subsets=(Subset("transparent", frozenset({Material.TRANSPARENT})),),
    missing=Missing.COUNTED,
)
