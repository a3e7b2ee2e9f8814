"""Compare predicted with true depth: of one image, and the mean over images.

python examples/05_depth_metrics.py
"""

import numpy as np

from benchmark.metrics import DepthMetrics, depth_errors

# Metres. A table at 0.8 m with a cup in front of it; the sensor misses half of the cup.
true = np.full((48, 64), 0.8)
true[16:40, 24:40] = 0.65
measured = true + np.random.default_rng(0).normal(0, 0.002, true.shape)
measured[16:40, 24:32] = 0.0  # no measurement
cup = np.zeros(true.shape, bool)
cup[16:40, 24:40] = True

errors = depth_errors(measured, true, cup)
print(
    f"on the cup: MAE {1000 * errors.mae:.1f} mm, where measured {1000 * errors.mae_answered:.1f}"
)
print(f"            {errors.coverage:.0%} of its pixels have depth")
print(f"            {errors.d105:.0%} within a factor of 1.05")

# Over a data set: the mean of the images' figures, as published tables have it.
metrics = DepthMetrics()
for noise in (0.001, 0.003):
    metrics.update(true + np.random.default_rng(1).normal(0, noise, true.shape), true, cup)
means = metrics.compute()
print(f"{metrics.images} images: RMSE {1000 * means['rmse']:.1f} mm")
