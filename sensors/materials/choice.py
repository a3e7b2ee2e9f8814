"""Which material class an object gets: probabilities per category, and the ablations' switches."""

from __future__ import annotations

from collections.abc import Collection
from functools import lru_cache
from pathlib import Path

import numpy as np

from sensors.materials.library import MATERIAL_CLASSES, Document, MaterialClass, Share
from std_toolkit.errors import ToolkitError
from std_toolkit.io.documents import InvalidDocument, read_document

BUILT_IN = Path(__file__).with_name("object_classes.json")
FALLBACK_CATEGORY = "other"


class ClassChoice(Document, frozen=True, kw_only=True):
    """Probabilities of the material classes per object category.

    Attributes:
        source: where the figures come from.
        probabilities: category to class to probability; each row sums to 1 and `other` is there.
    """

    source: str = ""
    probabilities: dict[str, dict[MaterialClass, Share]]

    def __post_init__(self) -> None:
        if FALLBACK_CATEGORY not in self.probabilities:
            raise InvalidDocument(
                f"needs a row {FALLBACK_CATEGORY!r} for categories not named",
                field="probabilities",
            )
        for category, row in self.probabilities.items():
            if abs(sum(row.values()) - 1) > 1e-6:
                raise InvalidDocument(
                    "probabilities must sum to 1",
                    field=f"probabilities.{category}",
                    value=sum(row.values()),
                )

    def row(self, category: str) -> dict[MaterialClass, Share]:
        """Probabilities of a category, those of `other` where it is not named."""
        return self.probabilities.get(category, self.probabilities[FALLBACK_CATEGORY])


def load_class_choice(path: Path | str | None = None) -> ClassChoice:
    """Read the built-in probabilities, or a user's file of the same form.

    Raises:
        ToolkitError: unreadable or inconsistent; names the file and the field.
    """
    return _built_in() if path is None else read_document(path, ClassChoice)


@lru_cache(maxsize=1)
def _built_in() -> ClassChoice:
    return read_document(BUILT_IN, ClassChoice)


def draw_material_class(
    rng: np.random.Generator,
    category: str,
    *,
    allowed: Collection[MaterialClass] = MATERIAL_CLASSES,
    choice: ClassChoice | None = None,
) -> MaterialClass:
    """Draw the material class of an object; consumes one random number.

    Args:
        rng: the scene's generator.
        category: "bottle", ...; unknown ones count as "other".
        allowed: classes left by an ablation: `("raw",)` keeps the original materials, a set
            without "transparent" spreads its probability over the others in their proportion.
        choice: the built-in probabilities by default.

    Raises:
        ToolkitError: `allowed` is empty.
    """
    row = (choice or load_class_choice()).row(category)
    names = [c for c in MATERIAL_CLASSES if c in allowed]
    if not names:
        raise ToolkitError("no material class is allowed", field="allowed", value=list(allowed))
    weights = np.array([row.get(c, 0.0) for c in names])
    if weights.sum() == 0:  # the category would take none of those allowed
        weights = np.ones(len(names))
    at = int(np.searchsorted(np.cumsum(weights / weights.sum()), rng.random(), side="right"))
    return names[min(at, len(names) - 1)]
