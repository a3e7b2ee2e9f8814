"""Choosing objects of a frame by material, category, and whether they are distractors."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from benchmark.data.frame import DepthFrame, Instance, Material
from std_toolkit.errors import ToolkitError
from std_toolkit.scene.model import CATEGORY_CLASS_IDS

OTHER = 0


@dataclass(frozen=True)
class Selection:
    """Which objects count.

    Attributes:
        materials: empty for all.
        categories: names, as "mug"; empty for all.
        distractors: whether objects of no category (class 0, "other") count. Category-novel sets
            and ClearGrasp consist of nothing else.

    Example:
        >>> glass = Instance(3, 6, Material.TRANSPARENT, "mug")
        >>> Selection(materials=frozenset({Material.SPECULAR})).wants(glass)
        False
        >>> Selection(categories=frozenset({"mug"}), distractors=False).wants(glass)
        True
    """

    materials: frozenset[Material] = frozenset()
    categories: frozenset[str] = frozenset()
    distractors: bool = True

    def wants(self, instance: Instance) -> bool:
        """Whether an object counts."""
        if self.materials and instance.material not in self.materials:
            return False
        if self.categories and instance.category not in self.categories:
            return False
        return self.distractors or instance.class_id != OTHER

    def mask(self, frame: DepthFrame) -> NDArray[np.bool_]:
        """(k, l) pixels of the objects that count."""
        return frame.mask_where(self.wants)


def selection_of(
    *, materials: list[str] | None = None, categories: list[str] | None = None, distractors: bool
) -> Selection:
    """A selection of names as on a command line.

    Args:
        materials: of raw, diffuse, transparent, specular.
        categories: of the data sets' seven; "other" for the rest.

    Raises:
        ToolkitError: no such material or category.
    """
    chosen = []
    for name in materials or []:
        if name.upper() not in Material.__members__:
            known = ", ".join(m.name.lower() for m in Material)
            raise ToolkitError("no such material", field="material", value=name, hint=known)
        chosen.append(Material[name.upper()])
    for name in categories or []:
        if name not in CATEGORY_CLASS_IDS:
            raise ToolkitError(
                "no such category", field="category", value=name, hint=", ".join(CATEGORY_CLASS_IDS)
            )
    return Selection(frozenset(chosen), frozenset(categories or []), distractors)


def material_masks(frame: DepthFrame) -> dict[Material, NDArray[np.bool_]]:
    """(k, l) pixels of every material that an object of the frame has."""
    present = sorted({i.material for i in frame.instances})
    return {material: frame.mask_of(material) for material in present}
