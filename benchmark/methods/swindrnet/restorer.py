"""SwinDRNet as a restorer."""

from __future__ import annotations

import torch
from torch import nn

from benchmark.methods.network import NetworkRestorer, device_called
from benchmark.methods.registry import MethodOptions
from benchmark.methods.settings import configured, preset_of
from benchmark.methods.swindrnet.config import PRESETS
from benchmark.methods.swindrnet.fast import FastSwinDRNetwork
from benchmark.methods.swindrnet.network import SwinDRNetwork
from benchmark.methods.weights import load_weights, weights_for


class SwinDRNet(NetworkRestorer):
    """Depth and confidence from two Swin transformers; settings are those of `SwinDRNetConfig`.

    The default settings fit the weights that the authors published. On a processor, at full
    precision, it runs in a faster form that gives the same answers (`fast.py`).

    Raises:
        ToolkitError: an unknown setting, no weights or those of another network, no such device.
    """

    def __init__(self, options: MethodOptions) -> None:
        self.config = configured(preset_of(PRESETS, options.preset), options.settings)
        device = device_called(options.device)
        network = SwinDRNetwork(self.config)
        load_weights(network, weights_for("swindrnet", options))
        plain = not options.compile and options.precision == "fp32"
        super().__init__(
            FastSwinDRNetwork(network) if plain and device.type == "cpu" else network,
            options,
            self.config.input_size,
        )

    def skeleton(self) -> nn.Module:
        with torch.device("meta"):
            return SwinDRNetwork(self.config).eval()
