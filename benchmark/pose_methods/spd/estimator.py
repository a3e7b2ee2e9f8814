"""SPD as a pose estimator."""

from __future__ import annotations

from benchmark.methods.network import device_called
from benchmark.methods.registry import MethodOptions
from benchmark.methods.settings import configured, preset_of
from benchmark.methods.weights import load_weights, weights_for
from benchmark.pose_methods.deforming import DeformingEstimator
from benchmark.pose_methods.spd.config import PRESETS
from benchmark.pose_methods.spd.network import SPDNetwork


class SPD(DeformingEstimator):
    """A prior of the category, deformed to the object; settings are those of `SPDConfig`.

    Raises:
        ToolkitError: an unknown setting, no weights or those of another network, no such device.
    """

    def __init__(self, options: MethodOptions) -> None:
        config = configured(preset_of(PRESETS, options.preset), options.settings)
        device_called(options.device)
        network = SPDNetwork(config)
        load_weights(network, weights_for("spd", options))
        super().__init__(network, options)
