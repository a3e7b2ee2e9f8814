"""The losses of pose networks: gradients by differences, values by hand, turns of round objects."""

from __future__ import annotations

import math

import pytest
import torch
from torch import Tensor

from benchmark.methods.pose.nocs.detector import Boxes, Regions, places_of
from benchmark.methods.pose.nocs.nocs import NOCSPrediction
from benchmark.methods.pose.swindrnet_nocs.swindrnet_nocs_network import SwinNOCSPrediction
from benchmark.training.pose.nocs_losses import (
    TURNS,
    NOCSLoss,
    NOCSTarget,
    PoseTarget,
    SwinNOCSLoss,
    assign,
    bin_of,
    focal_loss,
    generalised_overlap,
    is_round,
    middle_of,
    nearest_turn,
    turned,
)
from benchmark.training.pose.nocs_training import jittered, nocs_target, pose_target
from std_toolkit.errors import ToolkitError

SIDE = 12
BOTTLE, CAMERA, CAN, BACK = 1, 3, 4, 8


def a_target(first: int = BOTTLE, second: int = CAMERA, seed: int = 0) -> PoseTarget:
    """Two objects, numbers 4 and 9, of these classes, beside each other in each of two images."""
    draw = torch.Generator().manual_seed(seed)
    mask = torch.full((2, SIDE, SIDE), 255, dtype=torch.uint8)
    mask[:, 1:9, 1:6], mask[:, 3:11, 7:12] = 4, 9
    classes = torch.full(mask.shape, BACK)
    classes[mask == 4], classes[mask == 9] = first, second
    nocs = torch.rand(2, 3, SIDE, SIDE, generator=draw, dtype=torch.float64) * 0.8 + 0.1
    known = mask != 255
    return PoseTarget(classes, nocs * known[:, None], known, mask)


def an_answer(target: PoseTarget, nocs: Tensor) -> SwinNOCSPrediction:
    """Right classes, and these coordinates."""
    classes = torch.full((2, 9, SIDE, SIDE), -30.0, dtype=torch.float64)
    return SwinNOCSPrediction(classes.scatter(1, target.classes[:, None], 30.0), nocs)


def given_regions(target: PoseTarget) -> Regions:
    objects = [(0, 4), (0, 9), (1, 4), (1, 9)]
    boxes = {4: (0.5, 0.5, 5.5, 8.5), 9: (6.5, 2.5, 11.5, 10.5)}
    classes = [int(target.classes[target.mask == number].max()) for _, number in objects]
    return Regions(
        torch.tensor([boxes[number] for _, number in objects], dtype=torch.float64),
        torch.tensor([image for image, _ in objects]),
        torch.tensor(classes),
        torch.ones(4),
        torch.tensor([number for _, number in objects]),
    )


def found_boxes(seed: int = 0) -> Boxes:
    draw = torch.Generator().manual_seed(seed)
    places = torch.cat(
        [places_of(3, 3, 4, torch.device("cpu")), places_of(2, 2, 8, torch.device("cpu"))]
    )
    n = len(places)

    def some(*shape: int) -> Tensor:
        return torch.rand(*shape, generator=draw, dtype=torch.float64)

    strides = torch.tensor([4] * 9 + [8] * 4)
    return Boxes(some(2, n, 7) - 0.5, some(2, n, 4) * 5 + 1, some(2, n), places.double(), strides)


def right_bins(nocs: Tensor, sharp: float = 40.0) -> Tensor:
    """(n, 3, 32, s, s) logits that are sure of coordinates (n, s, s, 3)."""
    wanted = bin_of(nocs, 32).permute(0, 3, 1, 2)[:, :, None]
    n, s = nocs.shape[:2]
    return torch.zeros(n, 3, 32, s, s, dtype=torch.float64).scatter(2, wanted, sharp)


def test_turns_are_about_y_through_the_middle():
    point = torch.tensor([[0.9, 0.3, 0.5]], dtype=torch.float64)
    quarter = turned(point, torch.tensor([1]), 1)[0]
    angle = math.pi / 3
    expected = [0.5 + 0.4 * math.cos(angle), 0.3, 0.5 - 0.4 * math.sin(angle)]
    assert quarter.tolist() == pytest.approx(expected)
    whole = point
    for _ in range(TURNS):
        whole = turned(whole, torch.tensor([1]), 1)
    assert torch.allclose(whole, point)


def test_round_are_bottle_bowl_and_can():
    assert is_round(torch.arange(9)).tolist() == [c in (1, 2, 4) for c in range(9)]


@pytest.mark.parametrize("turn", range(1, TURNS))
def test_a_turned_bottle_is_as_right_and_a_turned_camera_is_not(turn):
    target = a_target()
    number = torch.tensor(turn)
    bottles = torch.where(
        (target.classes == BOTTLE)[:, None], turned(target.nocs, number, 1), target.nocs
    )
    cameras = torch.where(
        (target.classes == CAMERA)[:, None], turned(target.nocs, number, 1), target.nocs
    )
    loss = SwinNOCSLoss()
    assert float(loss(an_answer(target, target.nocs), target).total) < 1e-5
    assert float(loss(an_answer(target, bottles), target).total) < 1e-5
    assert float(loss(an_answer(target, cameras), target).total) > 0.1


def test_each_instance_turns_for_itself():
    """Two round objects, answered after different turns: right, unless an image turns as one."""
    target = a_target(BOTTLE, CAN)
    nocs = turned(target.nocs, torch.tensor(2), 1)
    nocs = torch.where((target.mask == 9)[:, None], turned(target.nocs, torch.tensor(5), 1), nocs)
    assert float(SwinNOCSLoss()(an_answer(target, nocs), target).total) < 1e-5
    together = SwinNOCSLoss(turns="image")(an_answer(target, nocs), target).total
    assert float(together) > 0.1
    same = turned(target.nocs, torch.tensor(2), 1)
    assert float(SwinNOCSLoss(turns="image")(an_answer(target, same), target).total) < 1e-5


def test_the_nearest_turn_is_that_of_a_loop():
    target = a_target(BOTTLE, CAN)
    found = torch.rand(target.nocs.shape, generator=torch.Generator().manual_seed(3)).double()
    group = torch.arange(2)[:, None, None] * 256 + target.mask.long()
    chosen = nearest_turn(found, target.nocs, group, target.known)
    for image in range(2):
        for number in (4, 9):
            pixels = target.mask[image] == number
            costs = []
            for turn in range(TURNS):
                true = turned(target.nocs[image], torch.tensor(turn), 0)[:, pixels]
                apart = (found[image][:, pixels] - true).abs()
                costs.append(float(torch.where(apart < 0.1, apart**2 / 0.2, apart - 0.05).sum()))
            best = turned(target.nocs[image], torch.tensor(costs.index(min(costs))), 0)
            assert torch.allclose(chosen[image][:, pixels], best[:, pixels])
        assert torch.equal(
            chosen[image][:, ~target.known[image]], target.nocs[image][:, ~target.known[image]]
        )


def test_swin_loss_by_hand():
    """All coordinates off by 0.3 in x and 0.05 in z."""
    target = a_target(CAMERA, CAMERA)
    nocs = target.nocs.clone()
    nocs[:, 0] += 0.3
    nocs[:, 2] += 0.05
    smooth = (0.3 - 0.05) + 0.05**2 / 0.2
    distance = math.hypot(0.3, 0.05)
    answer = an_answer(target, nocs)
    loss = SwinNOCSLoss()(answer, target)
    assert float(loss.total) == pytest.approx(3 * (smooth + distance), rel=1e-6)
    flat = SwinNOCSPrediction(torch.zeros_like(answer.classes), nocs)
    loss = SwinNOCSLoss(coordinates=0.5, distance=2.0)(flat, target)
    expected = math.log(9) + 0.5 * (smooth + 2 * distance)
    assert float(loss.total) == pytest.approx(expected, rel=1e-6)


@pytest.mark.parametrize("turns", ["instance", "image"])
def test_swin_gradients_by_differences(turns):
    target = a_target(BOTTLE, CAN)
    draw = torch.Generator().manual_seed(1)
    classes = torch.rand(2, 9, SIDE, SIDE, generator=draw, dtype=torch.float64)
    nocs = torch.rand(2, 3, SIDE, SIDE, generator=draw, dtype=torch.float64)
    loss = SwinNOCSLoss(turns=turns)

    def total(classes: Tensor, nocs: Tensor) -> Tensor:
        return loss(SwinNOCSPrediction(classes, nocs), target).total

    inputs = (classes.requires_grad_(), nocs.requires_grad_())
    assert torch.autograd.gradcheck(total, inputs, eps=1e-7, atol=1e-5, fast_mode=True)


def test_nothing_to_learn_is_no_nan():
    target = a_target()
    empty = PoseTarget(
        torch.full_like(target.classes, BACK),
        torch.zeros_like(target.nocs),
        torch.zeros_like(target.known),
        torch.full_like(target.mask, 255),
    )
    nocs = torch.rand_like(target.nocs).requires_grad_()
    loss = SwinNOCSLoss()(an_answer(empty, nocs), empty).total
    loss.backward()
    assert torch.isfinite(loss)
    assert torch.isfinite(nocs.grad).all()


def test_nocs_gradients_by_differences():
    target = a_target(BOTTLE, CAMERA)
    regions, boxes = given_regions(target), found_boxes()
    draw = torch.Generator().manual_seed(2)
    masks = torch.rand(4, 6, 6, generator=draw, dtype=torch.float64)
    bins = torch.rand(4, 3, 32, 6, 6, generator=draw, dtype=torch.float64)
    loss = NOCSLoss()

    def total(
        classes: Tensor, edges: Tensor, middles: Tensor, masks: Tensor, bins: Tensor
    ) -> Tensor:
        found = boxes._replace(classes=classes, edges=edges, middles=middles)
        return loss(NOCSPrediction(found, regions, masks, bins), NOCSTarget(regions, target)).total

    inputs = (boxes.classes, boxes.edges, boxes.middles, masks, bins)
    inputs = tuple(each.requires_grad_() for each in inputs)
    answer = NOCSPrediction(boxes._replace(), regions, masks, bins)
    parts = loss(answer, NOCSTarget(regions, target)).parts
    assert all(float(part) > 0 for part in parts.values()), parts
    assert torch.autograd.gradcheck(total, inputs, eps=1e-7, atol=1e-5, fast_mode=True)


@pytest.mark.parametrize("turn", range(TURNS))
def test_bins_of_a_turned_bottle_are_as_right(turn):
    target = a_target(BOTTLE, CAMERA)
    regions, boxes = given_regions(target), found_boxes()
    from benchmark.methods.pose.nocs.detector import nearest_pixels

    true = nearest_pixels(regions.boxes, regions.image, target.nocs.permute(0, 2, 3, 1), 8)
    after = turned(true, torch.tensor(turn), 3)
    round_ones = (regions.class_ids == BOTTLE)[:, None, None, None]
    masks = torch.full((4, 8, 8), 30.0, dtype=torch.float64)

    def coordinates(nocs: Tensor) -> float:
        answer = NOCSPrediction(boxes, regions, masks, right_bins(nocs))
        return float(NOCSLoss()(answer, NOCSTarget(regions, target)).parts["coordinates"])

    assert coordinates(torch.where(round_ones, after, true)) < 1e-6
    if turn:
        assert coordinates(torch.where(round_ones, true, after)) > 1


def test_masks_are_learnt_in_the_region():
    target = a_target()
    regions, boxes = given_regions(target), found_boxes()
    whole = torch.full((4, 8, 8), 30.0, dtype=torch.float64)
    bins = torch.zeros(4, 3, 32, 8, 8, dtype=torch.float64)
    wide = regions._replace(boxes=regions.boxes + torch.tensor([0.0, 0, 0, 8]))
    losses = []
    for here in (regions, wide):
        answer = NOCSPrediction(boxes, here, whole, bins)
        losses.append(float(NOCSLoss()(answer, NOCSTarget(here, target)).parts["masks"]))
    assert losses[0] < 1e-9  # the box is the object's own, all of it inside
    assert losses[1] == pytest.approx(30 * 0.5, rel=0.02)  # twice as high: half of it outside
    uniform = NOCSPrediction(boxes, regions, whole, bins)
    part = NOCSLoss()(uniform, NOCSTarget(regions, target)).parts["coordinates"]
    assert float(part) == pytest.approx(3 * math.log(32))


def test_a_batch_without_objects_teaches_that_there_are_none():
    target = a_target()
    regions = Regions(*(part[:0] for part in given_regions(target)))
    boxes = found_boxes()
    boxes = boxes._replace(classes=boxes.classes.requires_grad_())
    masks = torch.zeros(0, 8, 8, dtype=torch.float64)
    bins = torch.zeros(0, 3, 32, 8, 8, dtype=torch.float64)
    loss = NOCSLoss()(NOCSPrediction(boxes, regions, masks, bins), NOCSTarget(regions, target))
    loss.total.backward()
    assert torch.isfinite(loss.total)
    assert (boxes.classes.grad > 0).all()


def test_places_answer_for_the_smallest_object_of_their_level():
    places = torch.cat(
        [places_of(8, 8, 8, torch.device("cpu")), places_of(4, 4, 16, torch.device("cpu"))]
    )
    strides = torch.tensor([8] * 64 + [16] * 16)
    boxes = torch.tensor([[0.0, 0, 40, 40], [16, 16, 32, 32], [0, 0, 63, 500]])
    found = assign(places, strides, boxes, torch.tensor([1, 5, 7]))
    at = {
        (float(x), float(y), int(s)): int(c)
        for (x, y), s, c in zip(places, strides, found.classes, strict=True)
    }
    assert at[19.5, 19.5, 8] == 5  # in both, near both middles: the smaller
    assert at[11.5, 11.5, 8] == 1  # within 1.5 strides of the larger one's middle, 20
    assert at[3.5, 3.5, 8] == 0  # inside, and far from it
    assert at[35.5, 59.5, 8] == 0
    # Of more than 64 pixels: the coarse level's, within 24 pixels of (31.5, 250): none is.
    assert 7 not in at.values()
    row = (places == torch.tensor([19.5, 19.5])).all(dim=1).nonzero()[0, 0]
    assert found.edges[row].tolist() == [3.5, 3.5, 12.5, 12.5]


def test_parts_of_the_detectors_loss_by_hand():
    logits, wanted = torch.tensor([0.0, 2.0, -1.0]), torch.tensor([1.0, 0.0, 0.0])
    p = logits.sigmoid()
    expected = torch.stack(
        [
            -0.25 * (1 - p[0]) ** 2 * p[0].log(),
            -0.75 * p[1] ** 2 * (1 - p[1]).log(),
            -0.75 * p[2] ** 2 * (1 - p[2]).log(),
        ]
    )
    assert torch.allclose(focal_loss(logits, wanted), expected)
    edges = torch.tensor([[2.0, 3, 2, 3], [1, 3, 3, 3], [0.0, 3, 4, 3]])
    assert middle_of(edges).tolist() == pytest.approx([1, math.sqrt(1 / 3), 0])
    one = torch.tensor([[0.0, 0, 2, 2], [0, 0, 2, 2], [0, 0, 1, 1]])
    other = torch.tensor([[0.0, 0, 2, 2], [1, 0, 3, 2], [2, 0, 3, 1]])
    expected_overlap = [1, 2 / 6, -1 / 3]  # the last: nothing common, a third of the hull empty
    assert generalised_overlap(one, other).tolist() == pytest.approx(expected_overlap)


def test_bins_are_those_of_the_published_formula():
    values = torch.tensor([0.0, 1 / 32, 1 / 32 + 1e-4, 0.5, 1.0])
    assert bin_of(values, 32).tolist() == [0, 0, 1, 15, 31]


def test_targets_of_a_batch():
    mask = torch.full((1, 10, 10), 255, dtype=torch.uint8)
    mask[0, :4, :4], mask[0, 5:9, 1:9], mask[0, 0, 9] = 3, 7, 8
    classes = torch.full((1, 256), 255, dtype=torch.uint8)
    classes[0, 3], classes[0, 7], classes[0, 8] = 0, 5, 2
    nocs = torch.full((1, 10, 10, 3), 51, dtype=torch.uint8)
    nocs[0, 5, 1] = 0
    target = pose_target({"mask": mask, "classes": classes, "nocs": nocs})
    assert sorted(target.classes.unique().tolist()) == [0, 2, 5, 8]
    assert int(target.known.sum()) == 32 - 1 + 1  # no coordinates at one pixel
    assert target.nocs.unique().tolist() == pytest.approx([0, 0.2])
    objects = nocs_target({"mask": mask, "classes": classes, "nocs": nocs}, NOCSLoss()).objects
    assert objects.ids.tolist() == [7]  # 3 is of no class, 8 too small
    assert objects.class_ids.tolist() == [5]
    assert objects.boxes.tolist() == [[0.5, 4.5, 8.5, 8.5]]
    with pytest.raises(ToolkitError, match="--nocs"):
        pose_target({"mask": mask})


def test_boxes_are_moved_by_a_share_of_their_size():
    torch.manual_seed(0)
    target = a_target()
    regions = given_regions(target)
    moved = jittered(regions, 0.1)
    size = regions.boxes[:, 2:] - regions.boxes[:, :2]
    off = (moved.boxes - regions.boxes).abs() / size.repeat(1, 2)
    assert 0 < float(off.max()) <= 0.1
    assert torch.equal(jittered(regions, 0.0).boxes, regions.boxes)
