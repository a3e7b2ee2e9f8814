"""NLSPN as a restorer."""

from __future__ import annotations

from benchmark.methods.network import NetworkRestorer, device_called
from benchmark.methods.nlspn.config import PRESETS
from benchmark.methods.nlspn.network import NLSPNetwork
from benchmark.methods.registry import MethodOptions
from benchmark.methods.settings import configured, preset_of
from benchmark.methods.weights import load_weights, weights_for

# Constants of the published program that its weights hold.
_CONSTANTS = ("prop_layer.w", "prop_layer.b", "prop_layer.w_conf")


class NLSPN(NetworkRestorer):
    """Depth that spreads along learned neighbours; settings are those of `NLSPNConfig`.

    Raises:
        ToolkitError: an unknown setting, no weights or those of another network, no such device.
    """

    def __init__(self, options: MethodOptions) -> None:
        self.config = configured(preset_of(PRESETS, options.preset), options.settings)
        device_called(options.device)
        network = NLSPNetwork(self.config)
        load_weights(network, weights_for("nlspn", options), ignored=_CONSTANTS)
        super().__init__(network, options, self.config.input_size)
