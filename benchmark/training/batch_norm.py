"""Batch-norm statistics, recomputed over many frames.

A network in training normalises by the statistics of each batch; a trained one by running means of
them, of which the last ten batches decide most. Where a batch has few numbers for each channel, as
at the top of a pooled pyramid, these means change from batch to batch, and with them the answers.
"""

from collections.abc import Callable, Iterable
from typing import Any

import torch
from torch import nn
from torch.nn.modules.batchnorm import _BatchNorm

from benchmark.training.step import Batch

BATCH_NORM_FRAMES = 400  # that statistics are recomputed over


@torch.no_grad()
def recompute_batch_norm(
    network: nn.Module, batches: Iterable[Batch], run: Callable[[Batch], Any]
) -> None:
    """Set the running statistics to their means over batches, and nothing else.

    Those of parts that are not in training mode, such as a frozen trunk, stay as they are.

    Args:
        network: whose weights stay as they are.
        batches: frames.
        run: sends a batch through the network.
    """
    norms = [part for part in network.modules() if isinstance(part, _BatchNorm) and part.training]
    if not norms:  # as in networks of transformers and perceptrons alone
        return
    momenta = [norm.momentum for norm in norms]
    modes = [(part, part.training) for part in network.modules()]
    network.eval()  # no dropout
    for norm in norms:
        norm.training = True
        norm.reset_running_stats()
        norm.momentum = None  # a mean over all batches
    for batch in batches:
        run(batch)
    for part, mode in modes:
        part.training = mode
    for norm, momentum in zip(norms, momenta, strict=True):
        norm.momentum = momentum
