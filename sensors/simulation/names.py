"""Names that the command line offers, apart from what they stand for: `--help` loads nothing."""

PRESET_NAMES = ("draft", "tiny", "dreds")
QUALITY_NAMES = ("rough", "draft", "better", "fine")
ORDERS = ("random", "arc", "spiral")
MATERIAL_SWITCHES = ("mixed", "fixed", "opaque")
SCENE_ORIGINS = ("drop", "graspnet")
