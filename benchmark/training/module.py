"""The training step: frames to a loss.

All random numbers of a step are a function of its number.
"""

from collections.abc import Callable, Iterable
from typing import Any

import pytorch_lightning as pl
import torch
from torch import Tensor, nn

from benchmark.data.frame import BACKGROUND
from benchmark.training.config import TrainConfig, seed_of
from benchmark.training.step import (
    Batch,
    ModelInput,
    StepFunction,
    model_input,
    recompute_batch_norm,
)
from std_toolkit.errors import ToolkitError

_NAMED = 8  # frames named in an error


class RestorerTraining(pl.LightningModule):
    """A network in training.

    Args:
        config: of the training.
        network: whatever `step` knows how to ask.
        step: sends a batch through the network to the loss.
        loss: what is minimised, as configured.
        key: name of a frame by its index.

    A step whose loss or gradients are not finite raises `ToolkitError` before it changes a weight.
    """

    def __init__(
        self,
        config: TrainConfig,
        network: nn.Module,
        step: StepFunction,
        loss: Any,
        key: Callable[[int], str],
    ) -> None:
        super().__init__()
        self.config, self.network, self.key = config, network, key
        self.step, self.loss = step, loss
        self.parts: dict[str, Tensor] = {}
        self._frames: list[int] = []
        self._change_color: list[Callable[[Tensor], Tensor]] = []
        if config.jitter:
            from benchmark.training.augmentation.color import jitter

            self._change_color.append(jitter())
        if config.colors:
            from benchmark.training.augmentation.color import ColorAugmentation

            self._change_color.append(ColorAugmentation())

    def recompute_batch_norm(self, batches: Iterable[Batch]) -> None:
        """Recompute the batch-norm statistics; see `benchmark.training.step`."""
        info = self.config.step_info(self.global_step)

        def run(batch: Batch) -> None:
            on = {name: tensor.to(self.device) for name, tensor in batch.items()}
            with self.trainer.precision_plugin.forward_context():
                self.step(self.network, self.loss, model_input(on), info)

        recompute_batch_norm(self.network, batches, run)

    def training_step(self, batch: Batch, batch_idx: int) -> Tensor:
        part = batch_idx % self.config.accumulate
        frames = batch["index"].tolist()
        self._frames = frames if part == 0 else self._frames + frames
        # No generator's state has to survive an interruption: dropout and augmentation of a step
        # depend on its number alone.
        torch.manual_seed(seed_of(self.config.seed, self.global_step, part, self.global_rank))
        with torch.no_grad(), torch.autocast(self.device.type, enabled=False):
            inputs = self.augmented(model_input(batch))
        loss = self.step(self.network, self.loss, inputs, self.config.step_info(self.global_step))
        if not torch.isfinite(loss.total):
            self._stop("the loss is not a number", {n: float(p) for n, p in loss.parts.items()})
        self.parts = {"loss": loss.total.detach(), **loss.parts}
        return loss.total

    def on_before_optimizer_step(self, optimizer: torch.optim.Optimizer) -> None:  # noqa: ARG002
        gradients = [p.grad for p in self.parameters() if p.grad is not None]
        norm = torch.nn.utils.get_total_norm(gradients)
        self.parts["gradient"] = norm
        if not torch.isfinite(norm):
            self._stop("the gradients are not numbers", None)

    def configure_optimizers(self) -> Any:
        config = self.config
        optimizer = config.optimization.make(self.network)
        schedule = torch.optim.lr_scheduler.LambdaLR(
            optimizer, lambda step: config.rate(step) / config.optimization.learning_rate
        )
        return {
            "optimizer": optimizer,
            "lr_scheduler": {"scheduler": schedule, "interval": "step"},
        }

    def augmented(self, inputs: ModelInput) -> ModelInput:
        """Frames as the configuration changes them; all draws are from torch's generators."""
        config = self.config
        if config.sizes:
            from benchmark.training.augmentation.frames import cropped

            drawn = int(torch.randint(len(config.sizes), ()))
            width, _, height = config.sizes[drawn].partition("x")
            inputs = cropped(inputs, (int(width), int(height)))
        if config.copy_paste:
            from benchmark.training.augmentation.frames import copy_paste

            inputs = copy_paste(inputs, config.copy_paste)
        if config.geometry:
            from benchmark.training.augmentation.frames import moved

            inputs = moved(inputs)
        if config.patterns:
            from benchmark.training.augmentation.frames import with_patterns

            inputs = inputs._replace(color=with_patterns(inputs, config.patterns))
        for change in self._change_color:
            inputs = inputs._replace(color=change(inputs.color))
        return self._with_other_depth(inputs)

    def _with_other_depth(self, inputs: ModelInput) -> ModelInput:
        """The frames with sensor depth as it may be, too, and with colour that says nothing."""
        config = self.config
        if config.object_dropout or config.clear_gone or config.clear_behind:
            from benchmark.training.augmentation import depth

            true, mask, made_of = (inputs.batch[name] for name in ("true", "mask", "materials"))
            seen_through = config.object_dropout or config.clear_behind
            scene = depth.without_objects(true, mask != BACKGROUND) if seen_through else None
            if share := config.object_dropout:
                changed = depth.drop_object_depth(inputs.depth, true, mask, made_of, share, scene)
                inputs = inputs._replace(depth=changed)
            if config.clear_gone or config.clear_behind:
                changed = depth.clear_depth(inputs, config.clear_gone, config.clear_behind, scene)
                inputs = inputs._replace(depth=changed)
        if config.depth_noise:
            from benchmark.training.augmentation.depth import with_noise

            inputs = inputs._replace(depth=with_noise(inputs.depth, config.depth_noise))
        if config.holes:
            from benchmark.training.augmentation.holes import cut_holes

            inputs = inputs._replace(depth=cut_holes(inputs, config.holes))
        if config.wrong_color:
            from benchmark.training.augmentation.depth import wrong_color

            inputs = wrong_color(inputs, config.wrong_color)
        return inputs

    def _stop(self, problem: str, value: object) -> None:
        names = [self.key(i) for i in self._frames[:_NAMED]]
        more = len(self._frames) - len(names)
        listed = ", ".join(names) + (f" and {more} more" if more else "")
        raise ToolkitError(
            f"{problem} at step {self.global_step}, frames {listed}",
            value=value,
            hint="the last checkpoint is kept; look at these frames, or make --learning-rate "
            "smaller",
        )
