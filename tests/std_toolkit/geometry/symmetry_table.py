"""Symmetries that a person expects of the 21 YCB meshes, written down before any measurement.

From pictures of the meshes and from what the objects are: cans and bowls are round, boxes have
three half turns, a label distinguishes all turns. `order` is the number of equal turns about the
main axis, 0 for any turn; `across` whether a half turn about an axis across it also fits. None
where a picture does not tell, such as whether the bottom of a can equals its lid.
"""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Expected:
    """Attributes: order and across as above; at_least: more turns than `order` are right too."""

    order: int
    across: bool | None = False
    at_least: bool = False


NONE = Expected(1)
ROUND, CAN = Expected(0), Expected(0, None)
HALF_TURN, BOX = Expected(2), Expected(2, True)

# Mesh: expected of its shape, and of its shape and colours together.
YCB: dict[str, tuple[Expected, Expected]] = {
    "002_master_chef_can": (CAN, NONE),
    "003_cracker_box": (BOX, NONE),
    "004_sugar_box": (BOX, NONE),
    "005_tomato_soup_can": (CAN, NONE),
    "006_mustard_bottle": (HALF_TURN, NONE),
    "007_tuna_fish_can": (CAN, NONE),
    "008_pudding_box": (BOX, NONE),
    "009_gelatin_box": (BOX, NONE),
    "010_potted_meat_can": (Expected(2, None), NONE),
    "011_banana": (NONE, NONE),
    "019_pitcher_base": (NONE, NONE),
    "021_bleach_cleanser": (NONE, NONE),
    "024_bowl": (ROUND, ROUND),
    "025_mug": (NONE, NONE),
    "035_power_drill": (NONE, NONE),
    "036_wood_block": (Expected(4, True), Expected(2, None, at_least=True)),
    "037_scissors": (NONE, NONE),
    "040_large_marker": (ROUND, NONE),
    "051_large_clamp": (HALF_TURN, HALF_TURN),
    "052_extra_large_clamp": (HALF_TURN, HALF_TURN),
    "061_foam_brick": (Expected(2, None, at_least=True), HALF_TURN),
}
