"""The paper's released evaluation, to the letter."""

from benchmark.metrics.missing import Missing
from benchmark.protocols.protocol import HARD, Grid, Protocol, Subset

# The released code hands (width, height) to a function that takes (rows, columns): its grid has
# 224 rows and 126 columns, the transposed shape of the "126x224" of the text.
PAPER = Protocol(
    name="paper",
    about="the paper's released evaluation, its transposed grid and unclamped predictions included",
    grids=(Grid("h224w126", (126, 224), through=((224, 224),)),),
    subsets=(Subset("all"), Subset("specular+transparent", HARD)),
    missing=Missing.AS_GIVEN,
    view_size=(224, 224),
)
