"""A method of your own: missing depth becomes the median of what the sensor measured.

python examples/07_write_your_own_restorer.py

`std-bench --method examples/07_write_your_own_restorer.py:MedianDepth --split ... --data ...`
scores it beside the built-in ones.
"""

import sys
from collections.abc import Sequence
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from benchmark import MethodOptions, Restored, View, evaluate
from std_toolkit import ToolkitError


class MedianDepth:
    """See `benchmark.methods.protocol.Restorer`."""

    input_size = None  # takes views of any size
    needs_mask = False

    def __init__(self, options: MethodOptions) -> None:
        """What the user chose: preset, weights, device, settings."""

    def restore(self, views: Sequence[View]) -> list[Restored]:
        """Depth in metres of the size of each view."""
        answers = []
        for view in views:
            measured = view.depth[view.depth > 0]
            middle = np.float32(np.median(measured)) if len(measured) else np.float32(0)
            answers.append(Restored(np.where(view.depth > 0, view.depth, middle)))
        return answers


def main(folder: Path) -> None:
    """Score it on a small scene."""
    from sensors.synthetic import RecordingOptions, make_recording, scene_from_truth
    from std_toolkit import JobOptions, render_ground_truth

    options = RecordingOptions(frames=2, width=160, height=120, samples=1)
    make_recording(folder / "recording", options, jobs=JobOptions(workers=1))
    scene = scene_from_truth(folder / "recording", folder / "scenes" / "one")
    render_ground_truth(scene).raise_if_failed()
    table = evaluate(["raw", MedianDepth], "scenes", data=folder / "scenes")
    print(table[["method", "subset", "rmse", "mae", "d105"]].round(4).to_string(index=False))


if __name__ == "__main__":
    try:
        with TemporaryDirectory() as temporary:
            main(Path(temporary))
    except ToolkitError as error:
        sys.exit(f"error: {error}")
