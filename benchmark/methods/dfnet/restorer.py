"""DFNet as a restorer."""

from __future__ import annotations

from benchmark.methods.dfnet.config import PRESETS
from benchmark.methods.dfnet.network import DFNetwork
from benchmark.methods.network import NetworkRestorer, device_called
from benchmark.methods.registry import MethodOptions
from benchmark.methods.settings import configured, preset_of
from benchmark.methods.weights import load_weights, weights_for


class DFNet(NetworkRestorer):
    """A small U-Net of dense blocks; settings are those of `DFNetConfig`.

    Raises:
        ToolkitError: an unknown setting, no weights or those of another network, no such device.
    """

    def __init__(self, options: MethodOptions) -> None:
        self.config = configured(preset_of(PRESETS, options.preset), options.settings)
        device_called(options.device)
        network = DFNetwork(self.config)
        load_weights(network, weights_for("dfnet", options))
        super().__init__(network, options, self.config.input_size)
