"""What the paper's text says, with every hole counted; the default."""

from benchmark.data.frame import Material
from benchmark.metrics.missing import Missing
from benchmark.protocols.protocol import DIFFUSE, HARD, Grid, Protocol, Subset

STRICT = Protocol(
    name="strict",
    about="126x224 and native resolution; predictions that are missing or not positive cost",
    grids=(Grid("h126w224", (224, 126)), Grid("native", None)),
    subsets=(
        Subset("all"),
        Subset("specular+transparent", HARD),
        Subset("diffuse", DIFFUSE),
        Subset("specular", frozenset({Material.SPECULAR})),
        Subset("transparent", frozenset({Material.TRANSPARENT})),
        Subset("edges", edges=True),
        Subset("specular+transparent edges", HARD, edges=True),
    ),
    missing=Missing.COUNTED,
    depth_bins=tuple(round(0.2 + 0.1 * i, 1) for i in range(19)),
)
