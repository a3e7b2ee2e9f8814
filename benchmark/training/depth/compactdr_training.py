"""Training of CompactDR: what each of its answers should be, and the loss."""

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any, NamedTuple, cast

import numpy as np
import torch
from torch import Tensor, nn
from torch.nn.functional import binary_cross_entropy_with_logits, cross_entropy

from benchmark.data.frame import BACKGROUND, Material
from benchmark.methods.depth.compactdr import DEPTH_PARTS, MASK_PARTS, CompactDRNetwork, Looked
from benchmark.training import step
from benchmark.training.augmentation import depth, holes
from benchmark.training.depth.cleargrasp_losses import IGNORED, Outlines, outlines_of
from benchmark.training.depth.depth_losses import sobel, whole_around
from benchmark.training.validation import DepthValidator, evaluating

# Phases: the mask of colour with the encoder as it is, both, and what sees depth too with both as
# they are.
MASK, ENCODER, DEPTH = "mask", "encoder", "depth"

_LEARNING = {
    MASK: MASK_PARTS,
    ENCODER: ("encoder", *MASK_PARTS),
    DEPTH: DEPTH_PARTS,
}

# Weights of classes of edges: none, occlusion, contact. Most pixels are of none.
_EDGE_WEIGHTS = (1.0, 5.0, 5.0)

# Relative error whose square weighs as much as itself, and from which on it grows no faster.
_USUAL, _FAR = 0.05, 0.2
# Spreads from which on an error counts by its logarithm.
_FAR_SPREADS = 5.0


class CompactDRTarget(NamedTuple):
    """What the network should say of a batch.

    Attributes:
        depth: true depth and what belongs to it.
        masks: (b, 2, h, w) float, 1 on glass and on metal.
        outlines: normals and edges.
    """

    depth: step.Target
    masks: Tensor
    outlines: Outlines


@dataclass(frozen=True, kw_only=True)
class CompactDRLoss:
    """Weighted sum of the losses of all answers, each a mean over the pixels with truth.

    Depths are compared relative to the true one. Pixels of glass and metal count `clear` times,
    those of other objects `objects` times as much as the background.

    Attributes:
        depth: weight of the final depth: absolute error, and its square over 5 %.
        answer: the same of what the sensor's trust did not decide.
        moved: the same of the residual's depth alone, on glass and metal.
        slopes: Sobel sums of the error of the answer.
        masks, edges, normals, trust, off: of the heads.
        spread: negative logarithm of the Laplace density of the error, which grows more slowly from
            5 spreads on: a network that is far off would learn of nothing else.
        clear, objects: see above.
        right_mm, right_share: a measurement is right within the larger of the two, the second a
            share of its depth.
        off_mm, off_share: the continuation is not what is there from twice as much.
        gap: metres; neighbours farther apart in depth have an occlusion edge between them.
    """

    depth: float = 4.0
    answer: float = 2.0
    moved: float = 2.0
    slopes: float = 0.5
    masks: float = 6.0
    edges: float = 1.0
    normals: float = 0.5
    trust: float = 3.0
    off: float = 2.0
    spread: float = 0.1
    clear: float = 4.0
    objects: float = 2.0
    right_mm: float = 5.0
    right_share: float = 0.01
    off_mm: float = 5.0
    off_share: float = 0.01
    gap: float = 0.01

    def __call__(self, looked: Looked, target: CompactDRTarget) -> step.Loss:
        true, sensor = target.depth.depth, target.depth.sensor
        assert sensor is not None  # as the step gives it
        known = true > 0
        is_clear = target.masks.amax(dim=1, keepdim=True) > 0
        weight = (
            1
            + (self.objects - 1) * target.depth.foreground
            + (self.clear - self.objects) * (is_clear & target.depth.foreground)
        )
        weight = weight * known
        parts = {
            "depth": self._of_depth(looked.depth, true, weight),
            "answer": self._of_depth(looked.answer, true, weight),
            "moved": self._of_depth(looked.moved, true, weight * is_clear),
            "masks": self.of_masks(looked.masks, target.masks),
            "edges": self._of_edges(looked.edges, target.outlines),
            "normals": self._of_normals(looked.normals, target.outlines),
        }
        error = _relative(looked.answer - true, true, known)
        steeper = sobel(error).abs().sum(dim=1, keepdim=True)
        parts["slopes"] = step.weighted_mean(steeper, weight * whole_around(known))
        measured = (sensor > 0) & known
        right = (sensor - true).abs() <= _limit(true, self.right_mm, self.right_share)
        parts["trust"] = _of_logits(looked.trust, right, weight * measured)
        off = (looked.base.detach() - true).abs() > _limit(true, self.off_mm, self.off_share)
        parts["off"] = _of_logits(looked.off, off, weight)
        spread = looked.spread / true.clamp(min=0.05)
        apart = _relative(looked.depth - true, true, known).abs().detach()
        times = apart / spread
        grown = _FAR_SPREADS * (1 + (times / _FAR_SPREADS).clamp(min=1).log())
        times = torch.where(times > _FAR_SPREADS, grown, times)
        parts["spread"] = step.weighted_mean(times + spread.log(), weight)
        total = torch.stack([getattr(self, name) * part for name, part in parts.items()]).sum()
        return step.Loss(total, {name: part.detach() for name, part in parts.items()})

    def _of_depth(self, depth: Tensor, true: Tensor, weight: Tensor) -> Tensor:
        error = _relative(depth - true, true, weight > 0).abs()
        near = error.clamp(max=_FAR)
        return step.weighted_mean(error + near * (2 * error - near) / _USUAL, weight)

    def of_masks(self, masks: Tensor, wanted: Tensor) -> Tensor:
        """Cross entropy, and one less the soft Dice overlap: glass is a small part of images."""
        entropy = binary_cross_entropy_with_logits(masks, wanted)
        said = masks.sigmoid()
        both = (said * wanted).sum(dim=(0, 2, 3))
        either = said.sum(dim=(0, 2, 3)) + wanted.sum(dim=(0, 2, 3))
        return entropy + (1 - (2 * both + 1) / (either + 1)).mean()

    def _of_edges(self, edges: Tensor, outlines: Outlines) -> Tensor:
        weights = step.constant(_EDGE_WEIGHTS, edges)
        classes = outlines.boundaries
        total = cross_entropy(edges, classes, weights, ignore_index=IGNORED, reduction="sum")
        known = classes != IGNORED
        return total / (weights[classes.clamp(min=0)] * known).sum().clamp(min=1)

    def _of_normals(self, normals: Tensor, outlines: Outlines) -> Tensor:
        known = outlines.normals.square().sum(dim=1, keepdim=True) > 0.5
        bent = 1 - (normals * outlines.normals).sum(dim=1, keepdim=True)
        return step.mean_where(bent, known)


def _relative(error: Tensor, true: Tensor, known: Tensor) -> Tensor:
    """Error as a share of the true depth; 0 where that is unknown."""
    return error.masked_fill(~known, 0.0) / true.clamp(min=0.05)


def _limit(true: Tensor, mm: float, share: float) -> Tensor:
    return (share * true).clamp(min=mm / 1000)


def _of_logits(logits: Tensor, wanted: Tensor, weight: Tensor) -> Tensor:
    entropy = binary_cross_entropy_with_logits(logits, wanted.to(logits.dtype), reduction="none")
    return step.weighted_mean(entropy, weight)


def compactdr_target(
    batch: step.Batch, loss: CompactDRLoss, sensor: Tensor | None = None
) -> CompactDRTarget:
    """What the network should say of a batch, whose depth the network saw as `sensor`."""
    outlines = outlines_of(batch["true"][:, None], batch["mask"], batch["K"], loss.gap)
    return CompactDRTarget(
        step.target_of(batch)._replace(sensor=sensor), clear_masks(batch), outlines
    )


class CompactDRValidator(DepthValidator):
    """Sets how far spreads are too small by the frames of validation, then validates."""

    def states(self, network: nn.Module, *args: Any, **options: Any) -> np.ndarray:
        calibrate(cast(CompactDRNetwork, network), self.batches(self.chosen))
        return super().states(network, *args, **options)


WITHIN = 0.68
"""Share of the errors that one spread, a standard deviation, should hold."""
_GONE, _BEHIND = 0.4, 0.4  # of glass and metal, while spreads are measured
_SAMPLE, _MOST = 20000, 20.0  # pixels of a batch and kind; largest factor


@torch.no_grad()
def calibrate(network: CompactDRNetwork, batches: Iterable[step.Batch]) -> None:
    """Set `network.too_small`, so that `WITHIN` of the errors of each kind lie within one spread.

    The frames get holes anywhere, and glass and metal lose their depth or have that of what is
    behind, the same ones each time.
    """
    network.too_small.zero_()
    on = network.too_small.device
    found: list[list[Tensor]] = [[], [], []]
    with evaluating(network), torch.random.fork_rng():
        torch.manual_seed(0)
        for batch in batches:
            inputs = step.model_input({name: t.to(on) for name, t in batch.items()})
            true = inputs.batch["true"]
            scene = depth.without_objects(true, inputs.batch["mask"] != BACKGROUND)
            inputs = inputs._replace(depth=depth.clear_depth(inputs, _GONE, _BEHIND, scene))
            inputs = inputs._replace(depth=holes.cut_holes(inputs, 1.0))
            looked = network.look(inputs.color, inputs.depth)
            apart = (looked.depth - true[:, None]).abs() / (2**0.5 * looked.spread)
            kept = (looked.believed > 0.5) & (inputs.depth > 0)
            glass = ~kept & (looked.clear > 0.5)
            for values, kind in zip(found, (kept, ~kept & ~glass, glass), strict=True):
                chosen = apart[kind & (true[:, None] > 0)]
                values.append(chosen[:: max(1, len(chosen) // _SAMPLE)])
    for number, values in enumerate(found):
        together = torch.cat(values) if values else torch.zeros(0)
        if len(together):
            ratio = together.quantile(WITHIN).clamp(1 / _MOST, _MOST)
            network.too_small[number] = ratio.log()


def clear_masks(batch: step.Batch) -> Tensor:
    """(b, 2, h, w) float, 1 on glass and on metal."""
    made = [step.made_of(batch, one) for one in (Material.TRANSPARENT, Material.SPECULAR)]
    return torch.stack(made, dim=1).float()


def compactdr_step(
    network: nn.Module, loss: Any, inputs: step.ModelInput, step_info: step.StepInfo
) -> step.Loss:
    """The step of a network that answers with `Looked`, or before the phase `depth` with masks."""
    own, phase = cast(CompactDRNetwork, network), step_info.phase
    if phase:
        own.train_parts(_LEARNING[phase])
    on = inputs.color.device.type
    if phase in (MASK, ENCODER):
        masks = own.masks(inputs.color).float()
        with torch.autocast(on, enabled=False):
            total = loss.of_masks(masks, clear_masks(inputs.batch))
        return step.Loss(total, {"masks": total.detach()})
    looked = own.look(inputs.color, inputs.depth)
    looked = Looked(*(one.float() for one in looked))
    with torch.autocast(on, enabled=False):
        return loss(looked, compactdr_target(inputs.batch, loss, inputs.depth))
