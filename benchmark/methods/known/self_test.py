"""`std-bench self-test`: do the networks answer here what they answered where they were pinned?

Answers of seed 0 of released networks are those of the authors' programs. No program of authors was
at hand for other seeds, nor for networks that come with their weights: those answers are this
toolkit's own, and tell of a change.
"""

import time
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import msgspec
import numpy as np
import torch
from numpy.typing import NDArray

from benchmark.methods.known.released import RELEASED, Answers
from benchmark.methods.known.shipped import SHIPPED
from std_toolkit.io.documents import read_document

FILE = Path(__file__).with_name("answers.json")
SEEDS = (0, 1, 2)
# The released DFNet gives negative depth for it, as its last layer does.
NEGATIVE = {"dfnet released": (3,)}

# Arithmetic in another order, such as that of another processor, differs by less. Those of shipped
# weights differ by up to 3e-5 between one thread and two.
TOLERANCE = {"authors": 1e-4, "toolkit": 5e-4}
_SAMPLES = 24
# Propagation amplifies rounding: the median of the differences counts.
_BY_MEDIAN = ("final",)


class Known(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A pinned output: its shape, a few of its numbers, and three figures of all.

    Attributes:
        shape: of the output.
        low, high, mean: of its numbers.
        values: evenly spaced ones.
    """

    shape: list[int]
    low: float
    high: float
    mean: float
    values: list[float]

    @classmethod
    def of(cls, output: NDArray[np.floating]) -> "Known":
        """Return what is pinned of an output."""
        flat = np.asarray(output, np.float64).ravel()
        places = np.linspace(0, flat.size - 1, min(_SAMPLES, flat.size)).round().astype(int)
        low, high, mean = float(flat.min()), float(flat.max()), float(flat.mean())
        shape = list(np.shape(output))
        return cls(shape=shape, low=low, high=high, mean=mean, values=flat[places].tolist())

    def apart(self, other: "Known", *, by_median: bool) -> float:
        """Return the largest difference, relative where numbers are above 1; infinite between
        shapes, and where a number is not finite."""
        if self.shape != other.shape:
            return float("inf")
        mine, theirs = (np.array([k.low, k.high, k.mean, *k.values]) for k in (self, other))
        off = np.abs(mine - theirs) / np.maximum(1, np.abs(mine))
        if not np.isfinite(off).all():
            return float("inf")
        return float(np.median(off) if by_median else off.max())


class Pinned(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """The answer of a network to the inputs of a seed.

    Attributes:
        case, seed: which.
        by: whose program gave it.
        outputs: by name.
    """

    case: str
    seed: int
    by: Literal["authors", "toolkit"]
    outputs: dict[str, Known]


@dataclass(frozen=True)
class Tested:
    """Outcome of one answer.

    Attributes:
        pinned: what is wanted.
        apart: largest difference of any output.
        error: why there is no answer; "" if there is one.
        seconds: time it took.
    """

    pinned: Pinned
    apart: float
    error: str
    seconds: float

    @property
    def is_good(self) -> bool:
        """Whether the answer is the pinned one."""
        return not self.error and self.apart <= TOLERANCE[self.pinned.by]


def answer(case: str, seed: int) -> dict[str, Known]:
    """Return what is pinned of the answer of a network here."""
    call: Callable[[int], Answers] = {**RELEASED, **SHIPPED}[case]
    # These inputs are small: several threads would mostly wait for one another.
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        with torch.inference_mode():
            return {name: Known.of(output) for name, output in call(seed).items()}
    finally:
        torch.set_num_threads(threads)


def pinned(networks: Literal["all", "shipped", "released"] = "all") -> list[Pinned]:
    """Return the pinned answers of all networks, or of some.

    Raises:
        ToolkitError: the file of answers is damaged.
    """
    of = {"all": {**RELEASED, **SHIPPED}, "shipped": SHIPPED, "released": RELEASED}[networks]
    return [known for known in read_document(FILE, list[Pinned]) if known.case in of]


def self_test(wanted: Iterable[Pinned]) -> Iterable[Tested]:
    """Yield the outcome of each answer; a network that fails ends nothing."""
    for known in wanted:
        begin = time.perf_counter()
        error, apart = "", float("inf")
        try:
            found = answer(known.case, known.seed)
        except Exception as problem:
            error = f"{type(problem).__name__}: {' '.join(str(problem).split())}"
        else:
            if found.keys() == known.outputs.keys():
                apart = max(
                    found[name].apart(other, by_median=name in _BY_MEDIAN)
                    for name, other in known.outputs.items()
                )
        yield Tested(known, apart, error, time.perf_counter() - begin)
