"""Each network learns four frames by heart."""

from __future__ import annotations

import pytest

torch = pytest.importorskip("torch")

from network_cases import CASES, frames

# Steps, learning rate, and the share of the first loss that is left at most. Random images of the
# same kind, which are not learned, keep most of theirs.
PLANS = {
    "swindrnet-released": (120, 2e-3, 0.15),
    "swindrnet-paper": (120, 2e-3, 0.15),
    "swindrnet-no-confidence": (120, 2e-3, 0.15),
    "swindrnet-no-fusion": (120, 2e-3, 0.15),
    "nlspn": (120, 2e-3, 0.15),
    "dfnet": (120, 5e-3, 0.15),
}


@pytest.mark.slow
@pytest.mark.parametrize("name", PLANS)
def test_four_frames_are_learned(name):
    steps, rate, share = PLANS[name]
    network = CASES[name].make().train()
    color, depth, truth = frames(4)
    optimizer = torch.optim.AdamW(network.parameters(), rate, weight_decay=0)
    schedule = torch.optim.lr_scheduler.OneCycleLR(optimizer, rate, steps)
    losses = []
    for _ in range(steps):
        found = network(color, depth)
        loss = abs(found.depth - truth).mean()
        if found.initial is not None:
            loss = loss + 0.4 * abs(found.initial - truth).mean()
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
        schedule.step()
        losses.append(loss.item())
    assert losses[-1] < share * losses[0], (losses[0], losses[-1])
    # Better than the sensor, which is what restoring means.
    network.eval()
    with torch.inference_mode():
        error = abs(network(color, depth).depth - truth).mean()
    assert error < abs(depth - truth).mean()
