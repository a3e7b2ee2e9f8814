"""SGPA as a pose estimator."""

from __future__ import annotations

from benchmark.methods.network import device_called
from benchmark.methods.registry import MethodOptions
from benchmark.methods.settings import configured, preset_of
from benchmark.methods.weights import load_weights, weights_for
from benchmark.pose_methods.deforming import DeformingEstimator
from benchmark.pose_methods.sgpa.config import PRESETS
from benchmark.pose_methods.sgpa.network import SGPANetwork


class SGPA(DeformingEstimator):
    """A prior adapted to the structure of the object and deformed; settings are those of
    `SGPAConfig`.

    Raises:
        ToolkitError: an unknown setting, no weights or those of another network, no such device.
    """

    def __init__(self, options: MethodOptions) -> None:
        config = configured(preset_of(PRESETS, options.preset), options.settings)
        device_called(options.device)
        network = SGPANetwork(config)
        load_weights(network, weights_for("sgpa", options))
        super().__init__(network, options)
