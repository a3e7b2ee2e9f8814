"""What an audit cannot see, in words: of every audit, and of this one."""

from __future__ import annotations

import numpy as np

from benchmark.evaluation.audit.record import Audit

_ALWAYS = (
    "A mesh that differs from its object looks like a label that is off: the error is that of "
    "label and mesh together.",
    "What no label names is not looked for: objects without a label, and hidden parts.",
    "An error that camera calibration, image and label share is in none of these figures.",
)


def unseen(audit: Audit) -> list[str]:
    """Sentences on what the audit cannot see, with the numbers of this set."""
    found = []
    labels = audit.labels
    blind = [x for x in labels if x.error_mm is None]
    alone = [x for x in labels if x.source == "one frame"]
    if blind:
        found.append(
            f"{len(blind)} of {len(labels)} labels: nothing says where the object is, so that any "
            "error may be there."
        )
    if alone:
        along, across = (
            float(np.median([getattr(x, name) or 0.0 for x in alone]))
            for name in ("along_std_mm", "weakest_deg")
        )
        found.append(
            f"Lone frames: the distance is as good as the sensor's depth (typically ± {along:.0f} "
            f"mm along the view, one deviation), and the turn to ± {across:.1f} deg; what is "
            "smaller is not seen."
        )
    several = [x for x in labels if x.source == "several frames"]
    if several:
        mm = float(np.median([x.weakest_mm or 0.0 for x in several]))
        deg = float(np.median([x.weakest_deg or 0.0 for x in several]))
        found.append(
            f"Scenes that stand still: the weakest direction is known to ± {mm:.1f} mm and "
            f"± {deg:.1f} deg (typical, one deviation)."
        )
    if any(s.cameras == "from the labels" for s in audit.scenes):
        found.append(
            "Camera poses follow from the labels in some scenes: an error that all labels of a "
            "frame share is not seen as one of the frame."
        )
    clear = [x for x in labels if x.material in ("transparent", "specular")]
    if clear:
        found.append(
            f"{len(clear)} labels are of glass or metal: depth says nothing there, and reflections "
            "may look like an outline."
        )
    missing = sorted({n for s in audit.scenes for n in s.without_mesh})
    if missing:
        found.append(f"{len(missing)} objects have no mesh here and are not judged: "
                     f"{', '.join(missing[:5])}.")  # fmt: skip
    images = sum(s.without_images for s in audit.scenes)
    if images:
        found.append(
            f"{images} frames have no images here: only labels against each other are judged."
        )
    looked, frames = (sum(getattr(s, n) for s in audit.scenes) for n in ("looked_at", "frames"))
    if looked < frames:
        found.append(f"{frames - looked} of {frames} frames were not read (--frames).")
    return [*found, *_ALWAYS]
