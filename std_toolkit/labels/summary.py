"""What a person wants to read about labels after a propagation."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from std_toolkit.scene.model import Labels
from std_toolkit.scene.scene import Scene


def label_lines(scene: Scene, labels: Labels) -> Iterator[str]:
    """One line per label, and one about its uncertainty where it is known."""
    registered = len(scene.registered_frames())
    for label in labels.labels:
        name = scene.objects.object(label.object).name
        if label.T_world_obj is None:
            yield f"{name}: no label (not annotated in a registered frame)"
            continue
        how = "refined" if label.refined else "propagated"
        views = 1 + len(label.views)
        yield (
            f"{name}: {how} from {views} annotated frame{'s' if views > 1 else ''} "
            f"to {registered} of {len(scene.frames)} frames"
        )
        if label.covariance is not None:
            std = np.sqrt(np.diag(np.reshape(label.covariance, (6, 6))))
            millimetres = ", ".join(f"{1000 * x:.2f}" for x in std[:3])
            degrees = ", ".join(f"{np.rad2deg(x):.2f}" for x in std[3:])
            yield f"  standard deviation ({millimetres}) mm, ({degrees}) deg on the object's axes"
        if label.weak_direction:
            yield f"  {label.weak_direction}"
