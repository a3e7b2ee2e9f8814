"""Each network learns four frames by heart; in short, the variants with most of their own parts."""

from __future__ import annotations

from dataclasses import replace

import pytest
import torch
from network_cases import CASES, frames

# Steps, learning rate, and the share of the first loss that is left at most. A network
# that learned the mean depth alone would keep more of it.
PLANS = {
    "swindrnet-released": (150, 3e-3, 0.1),
    "swindrnet-paper": (150, 3e-3, 0.05),
    # Relative depth begins near the answer.
    "swindrnet-details": (150, 3e-3, 0.2),
    "swindrnet-no-fusion": (150, 3e-3, 0.05),
    "nlspn": (120, 2e-3, 0.05),
    "nlspn-relative": (120, 2e-3, 0.1),
    "dfnet": (70, 5e-3, 0.08),
    "dfnet-relative": (70, 5e-3, 0.3),
}

# In short: `test_training_learns` of test_training_fit.py trains every network, and tests of the
# networks check their variants one step at a time.
LONG = {*PLANS} - {"swindrnet-paper"}


@pytest.mark.slow
@pytest.mark.parametrize(
    "name", [pytest.param(n, marks=[pytest.mark.long] if n in LONG else []) for n in PLANS]
)
def test_four_frames_are_learned(name):
    steps, rate, share = PLANS[name]
    case = CASES[name]
    if case.method == "swindrnet":  # what hinders learning by heart
        case = replace(case, config=replace(case.config, drop_path=0.0, dropout=0.0))
    network = case.make().train()
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
    network.eval()
    with torch.inference_mode():
        error = abs(network(color, depth).depth - truth).mean()
    assert error < 0.5 * abs(depth - truth).mean()  # of the sensor
