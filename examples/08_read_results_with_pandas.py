"""Read the figures of each image from results of `std-bench`, and make a table of your own.

python examples/08_read_results_with_pandas.py [RESULTS]
"""

import sys
from pathlib import Path
from tempfile import TemporaryDirectory

import pandas as pd

from benchmark import evaluate, read_results
from std_toolkit import ToolkitError


def table(results: Path) -> pd.DataFrame:
    """Means over images by method and the pixels that are compared, in mm and percent."""
    runs = read_results([results])
    rows = pd.concat(
        [run.table.assign(method=run.manifest.label) for run in runs], ignore_index=True
    )
    means = rows.groupby(["method", "subset"], observed=True)[["rmse", "mae", "d105"]].mean()
    return means * [1000, 1000, 100]


def example_results(folder: Path) -> Path:
    """Two methods on a small synthetic scene."""
    from sensors.synthetic import RecordingOptions, make_recording, scene_from_truth
    from std_toolkit import JobOptions, render_ground_truth

    options = RecordingOptions(frames=2, width=160, height=120, samples=1)
    make_recording(folder / "recording", options, jobs=JobOptions(workers=1))
    scene = scene_from_truth(folder / "recording", folder / "scenes" / "one")
    render_ground_truth(scene).raise_if_failed()
    evaluate(["raw", "nearest"], "scenes", data=folder / "scenes", out=folder / "results")
    return folder / "results"


if __name__ == "__main__":
    try:
        with TemporaryDirectory() as temporary:
            given = Path(sys.argv[1]) if len(sys.argv) > 1 else example_results(Path(temporary))
            print(table(given).round(1).to_string())
    except ToolkitError as error:
        sys.exit(f"error: {error}")
