"""SPD as a pose estimator."""

from __future__ import annotations

from benchmark.methods.network import network_of
from benchmark.methods.pose.crop_estimator import CropEstimator
from benchmark.methods.pose.released_keys import spd_state
from benchmark.methods.pose.spd_network import PRESETS, SPDNetwork
from benchmark.methods.registry import MethodOptions


class SPD(CropEstimator):
    """A prior of the category, deformed to the object; settings are those of `SPDConfig`.

    Raises:
        ToolkitError: an unknown setting, no weights or those of another network, no such device.
    """

    def __init__(self, options: MethodOptions) -> None:
        _, network = network_of("spd", PRESETS, SPDNetwork, options, renamed=spd_state)
        super().__init__(network, options)
