"""The losses: their gradients by differences, their values by loops and by hand."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch
from torch import Tensor

from benchmark.methods.network import Prediction
from benchmark.training.depth.depth_losses import (
    DFNetLoss,
    NLSPNLoss,
    SwinDRNetLoss,
    normals,
    released_camera,
    sobel,
    whole_around,
)
from benchmark.training.step import Target, mean_where

LOSSES = {
    "swindrnet": SwinDRNetLoss(),
    "swindrnet-released": SwinDRNetLoss(form="released"),
    "swindrnet-near": SwinDRNetLoss(near=0.6),
    "nlspn": NLSPNLoss(),
    "nlspn-unlimited": NLSPNLoss(farthest=None),
    "dfnet": DFNetLoss(smoothness=0.1),
    "dfnet-foreground": DFNetLoss(smoothness=0.1, foreground_only=True),
    "nlspn-objects": NLSPNLoss(objects=4.0),
    "dfnet-objects": DFNetLoss(smoothness=0.1, objects=4.0),
}


def a_target(seed: int = 0, *, holes: bool = True, b: int = 2, side: int = 6) -> Target:
    draw = torch.Generator().manual_seed(seed)
    depth = torch.rand(b, 1, side, side, generator=draw, dtype=torch.float64) * 0.3 + 0.5
    if holes:
        depth[:, :, 0, :3] = 0
    foreground = torch.rand(b, 1, side, side, generator=draw) < 0.5
    K = torch.tensor([[7.0, 0, 2.6], [0, 6.5, 2.4], [0, 0, 1]], dtype=torch.float64)
    return Target(depth, foreground, K.expand(b, 3, 3))


def a_prediction(target: Target, seed: int = 1) -> Tensor:
    draw = torch.Generator().manual_seed(seed)
    noise = torch.rand(target.depth.shape, generator=draw, dtype=torch.float64)
    return 0.5 + 0.3 * noise


@pytest.mark.parametrize("name", LOSSES)
def test_gradients_are_those_of_differences(name):
    target = a_target()
    final, initial = a_prediction(target), a_prediction(target, 2)

    def total(depth: Tensor, first: Tensor) -> Tensor:
        return LOSSES[name](Prediction(depth, first), target).total

    inputs = (final.requires_grad_(), initial.requires_grad_())
    assert torch.autograd.gradcheck(total, inputs, eps=1e-7, atol=1e-5)


@pytest.mark.parametrize("name", LOSSES)
def test_gradients_are_finite_where_nothing_is_known_and_everything_is_right(name):
    target = a_target()
    for true in (torch.zeros_like(target.depth), torch.full_like(target.depth, 0.7)):
        depth = true.clone().requires_grad_()
        loss = LOSSES[name](Prediction(depth, depth), target._replace(depth=true)).total
        loss.backward()
        assert torch.isfinite(loss)
        assert torch.isfinite(depth.grad).all()


@pytest.mark.parametrize("name", LOSSES)
def test_the_truth_itself_costs_nothing_and_anything_else_something(name):
    target = a_target(holes=False)
    loss = LOSSES[name]
    assert loss(Prediction(target.depth, target.depth), target).total.item() < 1e-12
    assert loss(Prediction(a_prediction(target), target.depth), target).total.item() > 1e-3


@pytest.mark.parametrize("name", [n for n in LOSSES if "released" not in n])
def test_what_is_predicted_where_nothing_is_known_does_not_matter(name):
    target = a_target()
    one, other = a_prediction(target), a_prediction(target)
    other[:, :, 0, :2] += 0.37  # all their neighbours that are known lie beside column 2
    mine = LOSSES[name](Prediction(one, one.clone()), target)
    yours = LOSSES[name](Prediction(other, other.clone()), target)
    assert mine.total.item() == pytest.approx(yours.total.item(), rel=1e-12)


@pytest.mark.parametrize("squared", [0.0, 2.0])
def test_swindrnet_is_the_sum_that_is_written_down(squared: float):
    """By loops over pixels, without any of the functions that the loss is made of."""
    target = a_target(holes=False)
    final, initial = a_prediction(target), a_prediction(target, 2)
    b, _, h, w = final.shape
    K = released_camera(final)[0].numpy()
    true = target.depth.numpy()

    def slopes(d: np.ndarray, i: int, v: int, u: int) -> np.ndarray:
        out = np.zeros(2)
        for dv in (-1, 0, 1):
            for du in (-1, 0, 1):
                if 0 <= v + dv < h and 0 <= u + du < w:
                    x = d[i, 0, v + dv, u + du]
                    out += x * np.array([du * (2 - abs(dv)), dv * (2 - abs(du))])
        return out

    def point(d: np.ndarray, i: int, v: int, u: int) -> np.ndarray:
        z = d[i, 0, v, u]
        return z * np.array([(u - K[0, 2]) / K[0, 0], (v - K[1, 2]) / K[1, 1], 1])

    def normal(d: np.ndarray, i: int, v: int, u: int) -> np.ndarray:
        v, u = min(v, h - 2), min(u, w - 2)
        here = point(d, i, v, u)
        n = np.cross(point(d, i, v, u + 1) - here, point(d, i, v + 1, u) - here)
        return n / np.linalg.norm(n)

    def of_pixel(d: np.ndarray, i: int, v: int, u: int) -> float:
        turned = abs(normal(d, i, v, u) - normal(true, i, v, u)).mean()
        steeper = abs(slopes(d, i, v, u) - slopes(true, i, v, u)).sum()
        away = abs(d[i, 0, v, u] - true[i, 0, v, u])
        square = away**2 if away < 0.2 else 0.4 * away - 0.04
        return away + squared * square / 0.05 + 0.1 * turned + 0.6 * steeper

    inside, outside = [], []
    for i in range(b):
        for v in range(h):
            for u in range(w):
                cost = of_pixel(final.numpy(), i, v, u) + 0.4 * of_pixel(initial.numpy(), i, v, u)
                (inside if target.foreground[i, 0, v, u] else outside).append(cost)
    expected = np.mean(inside) + 0.4 * np.mean(outside)
    loss = SwinDRNetLoss(form="released", squared=squared)
    found = loss(Prediction(final, initial), target).total
    # The smallest length of a cross product is in the product's and not in numpy's.
    assert found.item() == pytest.approx(expected, rel=1e-6)


def test_confidence_is_compared_with_where_the_sensor_is_right():
    depth = torch.full((1, 1, 2, 4), 0.7, dtype=torch.float64)
    # Right, 2 cm off, a hole, and right where there is no truth.
    sensor = torch.tensor([0.705, 0.72, 0.0, 0.7], dtype=torch.float64).expand(1, 1, 2, 4)
    depth[..., 3] = 0
    foreground = torch.tensor([True, True, False, False]).expand(1, 1, 2, 4)
    target = Target(depth, foreground, torch.eye(3, dtype=torch.float64)[None], sensor)
    confidence = torch.tensor([0.8, 0.3, 0.1, 0.5], dtype=torch.float64).expand(1, 1, 2, 4)
    prediction = Prediction(depth, depth.clone(), confidence)
    found = SwinDRNetLoss(confidence=0.5)(prediction, target)
    inside = -(math.log(0.8) + math.log(1 - 0.3)) / 2
    outside = -math.log(1 - 0.1)
    assert found.total.item() == pytest.approx(0.5 * (inside + 0.4 * outside))
    assert found.parts["trust"].item() == pytest.approx((2 * inside + outside) / 3)


def test_pixels_beyond_near_count_by_the_square_of_their_distance():
    depth = torch.tensor([0.5, 1.0, 2.0, 4.0], dtype=torch.float64).expand(1, 1, 2, 4)
    target = Target(depth, torch.zeros(1, 1, 2, 4, dtype=torch.bool), torch.eye(3)[None].double())
    off = depth + 0.1
    loss = SwinDRNetLoss(near=1.0, normals=0, slopes=0, initial=0, background=1.0)
    found = loss(Prediction(off, off.clone(), None), target).total.item()
    assert found == pytest.approx(0.1 * (1 + 1 + 1 / 4 + 1 / 16) / 4)


def test_gradients_of_confidence_are_those_of_differences():
    target = a_target()._replace(sensor=a_target(3).depth)
    draw = torch.Generator().manual_seed(4)
    confidence = torch.rand(target.depth.shape, generator=draw, dtype=torch.float64) * 0.9 + 0.05

    def total(confidence: Tensor) -> Tensor:
        prediction = Prediction(a_prediction(target), a_prediction(target, 2), confidence)
        return SwinDRNetLoss(confidence=0.3)(prediction, target).total

    assert torch.autograd.gradcheck(total, (confidence.requires_grad_(),), eps=1e-7, atol=1e-5)


def test_both_forms_of_swindrnet_agree_on_whole_truth_with_the_released_camera():
    target = a_target(holes=False)
    target = target._replace(K=released_camera(target.depth))
    prediction = Prediction(a_prediction(target), a_prediction(target, 2))
    found = [SwinDRNetLoss(form=f)(prediction, target).total.item() for f in ("paper", "released")]
    assert found[0] == pytest.approx(found[1], rel=1e-12)


def test_nlspn_means_over_each_image_and_then_over_images():
    true = torch.tensor([[[[1.0, 1.0, 0.0, 0.0]]], [[[2.0, 2.0, 2.0, 2.0]]]])
    depth = torch.tensor([[[[1.5, 1.0, 9.0, 9.0]]], [[[2.0, 2.0, 2.0, 3.0]]]])
    target = Target(true, true > 0, torch.eye(3).expand(2, 3, 3))
    loss = NLSPNLoss()(Prediction(depth), target)
    assert loss.parts["absolute"].item() == pytest.approx((0.5 / 2 + 1 / 4) / 2)
    assert loss.parts["squared"].item() == pytest.approx((0.25 / 2 + 1 / 4) / 2)
    assert loss.total.item() == pytest.approx(0.25 + 0.1875)


@pytest.mark.parametrize("make", [NLSPNLoss, DFNetLoss])
def test_pixels_of_objects_count_more_on_request(make):
    true = torch.ones(1, 1, 2, 2)
    depth = torch.tensor([[[[1.2, 1.0], [1.1, 1.0]]]])  # one pixel of an object, three others
    foreground = torch.tensor([[[[True, False], [False, False]]]])
    target = Target(true, foreground, torch.eye(3)[None])
    for objects, share in ((1.0, 1 / 4), (3.0, 3 / 6), (0.5, 1 / 7)):
        found = make(objects=objects)(Prediction(depth), target).parts["squared"].item()
        rest = (1 - share) / 3
        assert found == pytest.approx(share * 0.2**2 + rest * 0.1**2, rel=1e-5)


def test_nlspn_gives_no_gradient_outside_its_range():
    true = torch.ones(1, 1, 1, 2)
    depth = torch.tensor([[[[-1.0, 12.0]]]], requires_grad=True)
    target = Target(true, true > 0, torch.eye(3)[None])
    NLSPNLoss()(Prediction(depth), target).total.backward()
    assert depth.grad.abs().max() == 0
    depth.grad = None
    NLSPNLoss(farthest=None)(Prediction(depth), target).total.backward()
    assert depth.grad.abs().min() > 0


def test_dfnet_leaves_out_what_is_out_of_range_and_tells_a_tilt():
    K = torch.tensor([[100.0, 0, 7.5], [0, 100.0, 7.5], [0, 0, 1]])[None]
    flat = torch.full((1, 1, 16, 16), 0.8)
    true = flat.clone()
    true[..., 8:, :] = 1.6
    target = Target(true, true > 0, K)
    assert DFNetLoss()(Prediction(flat), target).total.item() == pytest.approx(0, abs=1e-9)
    # A plane that is tilted by 45 degrees about the vertical: z = 0.8 + x.
    u = torch.arange(16.0)
    slant = (0.8 / (1 - (u - 7.5) / 100)).expand(1, 1, 16, 16)
    whole = target._replace(depth=flat)
    bent = DFNetLoss()(Prediction(slant), whole).parts["bent"].item()
    assert bent == pytest.approx(1 - math.sqrt(0.5), rel=1e-4)


def test_sobel_of_slopes():
    v, u = torch.meshgrid(torch.arange(5.0), torch.arange(5.0), indexing="ij")
    right, below = sobel((2 * u + 3 * v)[None, None])[0]
    assert (right[1:-1, 1:-1] == 16).all()
    assert (below[1:-1, 1:-1] == 24).all()


def test_normals_of_a_wall_look_along_the_view():
    K = torch.tensor([[50.0, 0, 4], [0, 50.0, 4], [0, 0, 1]])[None]
    found = normals(torch.full((1, 1, 8, 9), 2.0), K)
    assert found.shape == (1, 3, 8, 9)
    assert torch.allclose(found, torch.tensor([0.0, 0, 1])[None, :, None, None].expand_as(found))


def test_surroundings_end_with_the_image():
    known = torch.ones(1, 1, 4, 4, dtype=torch.bool)
    assert whole_around(known).all()
    known[..., 0, 0] = False
    assert whole_around(known)[0, 0].sum() == 12


def test_mean_of_chosen_pixels_knows_no_others():
    values = torch.tensor([1.0, 3.0, float("nan")], requires_grad=True)
    mean = mean_where(values, torch.tensor([True, True, False]))
    mean.backward()
    assert mean.item() == 2
    assert values.grad.tolist() == [0.5, 0.5, 0]
    nothing = mean_where(values, torch.zeros(3, dtype=torch.bool))
    assert nothing.item() == 0
