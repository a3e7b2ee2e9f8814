"""Score two methods that restore depth on your own labelled scenes.

python examples/06_score_a_restorer.py [FOLDER OF SCENES WITH GROUND TRUTH]
"""

import sys
from pathlib import Path
from tempfile import TemporaryDirectory

from benchmark.cli.bench import main as std_bench
from sensors.synthetic import RecordingOptions, make_recording, scene_from_truth
from std_toolkit import JobOptions, render_ground_truth


def synthetic_scenes(folder: Path) -> Path:
    """A folder with one scene of two small frames that has ground truth."""
    options = RecordingOptions(frames=2, width=160, height=120, samples=1)
    make_recording(folder / "recording", options, jobs=JobOptions(workers=1))
    scene = scene_from_truth(folder / "recording", folder / "scenes" / "one")
    render_ground_truth(scene).raise_if_failed()
    return folder / "scenes"


def score(scenes: Path, results: Path) -> int:
    """The same as the command line in a shell; returns its exit status."""
    words = ["--method", "raw", "nearest", "--split", "scenes", "--no-speed", "--no-gallery"]
    return std_bench([*words, "--data", str(scenes), "--out", str(results)])


if __name__ == "__main__":
    with TemporaryDirectory() as temporary:
        folder = Path(temporary)
        scenes = Path(sys.argv[1]) if len(sys.argv) > 1 else synthetic_scenes(folder)
        sys.exit(score(scenes, folder / "results"))
