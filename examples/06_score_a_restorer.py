"""Score two methods that restore depth on your own labelled scenes.

python examples/06_score_a_restorer.py [FOLDER OF SCENES WITH GROUND TRUTH]

`std-bench --method raw nearest --split scenes --data FOLDER --out RESULTS` does the same.
"""

import sys
from pathlib import Path
from tempfile import TemporaryDirectory

from benchmark import evaluate
from sensors.synthetic import RecordingOptions, make_recording, scene_from_truth
from std_toolkit import JobOptions, ToolkitError, render_ground_truth


def synthetic_scenes(folder: Path) -> Path:
    """A folder with one scene of two small frames that has ground truth."""
    options = RecordingOptions(frames=2, width=160, height=120, samples=1)
    make_recording(folder / "recording", options, jobs=JobOptions(workers=1))
    scene = scene_from_truth(folder / "recording", folder / "scenes" / "one")
    render_ground_truth(scene).raise_if_failed()
    return folder / "scenes"


def main(scenes: Path) -> None:
    table = evaluate(["raw", "nearest"], "scenes", data=scenes)
    rmse = table.pivot(index="method", columns="subset", values="rmse")  # metres
    print((1000 * rmse).round(1).to_string())


if __name__ == "__main__":
    try:
        if len(sys.argv) > 1:
            main(Path(sys.argv[1]))
        else:
            with TemporaryDirectory() as folder:
                main(synthetic_scenes(Path(folder)))
    except ToolkitError as error:
        sys.exit(f"error: {error}")
