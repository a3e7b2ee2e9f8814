"""What all network restorers do with views, devices and precisions."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from network_cases import views
from torch import nn

from benchmark.methods.network import NetworkRestorer, Prediction, count_macs, torch_device
from benchmark.methods.registry import MethodOptions
from std_toolkit.errors import ToolkitError


class Adding(nn.Module):
    """Depth plus ten times the red channel; the confidence is green times two."""

    def __init__(self) -> None:
        super().__init__()
        self.factor = nn.Parameter(torch.tensor(10.0))

    def forward(self, color, depth):
        assert not self.training and not torch.is_grad_enabled()
        return Prediction(depth + self.factor * color[:, :1], None, 2 * color[:, 1:2])


def adding(size: tuple[int, int] | None = None, **options) -> NetworkRestorer:
    return NetworkRestorer(Adding(), MethodOptions(**options), size)


def test_values_and_order_survive():
    some = views(3, (8, 6))
    answers = adding().restore(some)
    assert len(answers) == 3
    for view, answer in zip(some, answers, strict=True):
        expected = view.depth + 10 * view.color[..., 0].astype(np.float32) / 255
        np.testing.assert_allclose(answer.depth, expected, rtol=1e-6)
        green = 2 * view.color[..., 1].astype(np.float32) / 255
        np.testing.assert_allclose(answer.confidence, green.clip(0, 1), rtol=1e-6)
        assert answer.depth.dtype == answer.confidence.dtype == np.float32


def test_nothing_to_restore():
    assert adding().restore([]) == []


def test_other_sizes_go_through_the_input_size_by_nearest_pixels():
    (view,) = views(1, (12, 8))
    (answer,) = adding((6, 4)).restore([view])
    inner = (view.depth + 10 * view.color[..., 0].astype(np.float32) / 255)[::2, ::2]
    np.testing.assert_allclose(answer.depth, inner.repeat(2, 0).repeat(2, 1), rtol=1e-6)


def test_several_sizes_in_one_batch_are_refused():
    with pytest.raises(ToolkitError, match="8x6, 9x6"):
        adding().restore(views(1, (8, 6)) + views(1, (9, 6)))


def test_depths_that_are_none_become_zero():
    (view,) = views(1, (8, 6))
    view.color[:] = 0
    view.depth[0, :4] = [np.nan, np.inf, -np.inf, -1]
    (answer,) = adding().restore([view])
    assert (answer.depth[0, :4] == 0).all()
    assert (answer.depth[0, 4:] == view.depth[0, 4:]).all()


@pytest.mark.parametrize("name", ["cuda:77", "gpu", "cuda:x"])
def test_devices_that_are_not_there(name):
    with pytest.raises(ToolkitError, match="no such device") as caught:
        adding(device=name)
    assert "there is cpu" in str(caught.value) and name in str(caught.value)


@pytest.mark.skipif(torch.cuda.is_available(), reason="there is CUDA here")
def test_cuda_without_cuda():
    with pytest.raises(ToolkitError, match="--device: there is no such device here"):
        torch_device("cuda")


def test_unknown_precision():
    with pytest.raises(ToolkitError, match="fp32, bf16, fp16"):
        adding(precision="fp8")


@pytest.mark.parametrize("precision", ["bf16", "fp16"])
def test_narrow_arithmetic_is_used_and_answers_are_float32(precision):
    class Seeing(nn.Module):
        def __init__(self) -> None:
            super().__init__()
            self.conv = nn.Conv2d(4, 1, 1)

        def forward(self, color, depth):
            out = self.conv(torch.cat([color, depth], 1))
            self.seen = out.dtype
            return Prediction(out)

    network = Seeing()
    restorer = NetworkRestorer(network, MethodOptions(precision=precision), None)
    (answer,) = restorer.restore(views(1, (8, 6)))
    assert network.seen == {"bf16": torch.bfloat16, "fp16": torch.float16}[precision]
    assert answer.depth.dtype == np.float32 and answer.confidence is None


def test_memory_that_does_not_suffice_is_told():
    class Greedy(nn.Module):
        def forward(self, *_):
            raise torch.OutOfMemoryError("CUDA out of memory")

    restorer = NetworkRestorer(Greedy(), MethodOptions(), None)
    with pytest.raises(ToolkitError, match="--batch-size smaller"):
        restorer.restore(views(2))


def test_products_of_a_convolution_and_of_attention():
    conv = nn.Conv2d(3, 8, 3, padding=1)
    assert count_macs(conv, torch.rand(1, 3, 10, 20)) == 3 * 8 * 9 * 200

    class Attention(nn.Module):
        def forward(self, q):
            return nn.functional.scaled_dot_product_attention(q, q, q)

    assert count_macs(Attention(), torch.rand(1, 2, 50, 16)) == 2 * 2 * 50 * 50 * 16
