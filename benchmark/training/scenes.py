"""Which frames train and which judge: never two of one scene apart."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Sequence

from benchmark.training.packed_frames import PackedFrames
from std_toolkit.errors import ToolkitError

_TOLD = 3


def hold_out(frames: PackedFrames, share: float, *, seed: int) -> tuple[list[int], list[int]]:
    """Frames to train on, and those of a share of the scenes, at least one, to judge by.

    Raises:
        ToolkitError: there is only one scene, or the share is none.
    """
    if not 0 < share < 1:
        raise ToolkitError("must be between 0 and 1", field="hold_out", value=share)
    scenes = _drawn(frames, range(len(frames)), f"{seed}")
    if len(scenes) < 2:
        raise ToolkitError(
            f"too little data: {len(scenes)} scene, of which none can be held out for validation",
            hint="pack more scenes, or give --validation",
        )
    held = set(scenes[: math.ceil(share * (len(scenes) - 1))])
    sides: tuple[list[int], list[int]] = ([], [])
    for i in range(len(frames)):
        sides[frames.scene(i) in held].append(i)
    return sides


def thinned(frames: PackedFrames, chosen: list[int], share: float, *, seed: int) -> list[int]:
    """Those of the chosen frames that are of a share of their scenes, at least of one.

    Of a smaller share come some of the scenes of a larger one.

    Raises:
        ToolkitError: the share is none.
    """
    if not 0 < share <= 1:
        raise ToolkitError("must lie above 0 and at most 1", field="share", value=share)
    if share == 1:
        return chosen
    scenes = _drawn(frames, chosen, f"share {seed}")
    kept = set(scenes[: max(1, round(share * len(scenes)))])
    return [i for i in chosen if frames.scene(i) in kept]


def check_no_leak(
    training: PackedFrames,
    of_training: Sequence[int],
    validation: PackedFrames,
    of_validation: Sequence[int],
) -> None:
    """Refuse scenes, and frames of equal pixels, that are on both sides.

    Raises:
        ToolkitError: which they are (the first few), and how many.
    """
    for what, of in (("scenes", _scene), ("frames", _digest)):
        known = {of(training, i): i for i in of_training}
        both = [i for i in of_validation if of(validation, i) in known]
        if both:
            told = ", ".join(
                f"{validation.key(i)} = {training.key(known[of(validation, i)])}"
                for i in both[:_TOLD]
            )
            raise ToolkitError(
                f"{len(both)} frames of validation are of {what} that are trained on: {told}",
                hint="validate on other scenes, or leave --validation away to hold some out",
            )


def frames_digest(frames: PackedFrames, chosen: Sequence[int]) -> str:
    """A hash over frames, in their order."""
    text = "\n".join(_digest(frames, i) for i in chosen)
    return hashlib.sha256(text.encode()).hexdigest()


def _drawn(frames: PackedFrames, chosen: Sequence[int], salt: str) -> list[str]:
    """Scenes of the chosen frames in an order drawn at random."""

    def draw(scene: str) -> str:
        # Of the scene's own name: a scene more changes no other's place by much.
        name = scene.rpartition(": ")[2]
        return hashlib.sha256(f"{salt} {name}".encode()).hexdigest()

    return sorted(sorted({frames.scene(i) for i in chosen}), key=draw)


def _scene(frames: PackedFrames, index: int) -> str:
    return frames.scene(index)  # of whatever kind the packs are


def _digest(frames: PackedFrames, index: int) -> str:
    return frames.frames[index].digest
