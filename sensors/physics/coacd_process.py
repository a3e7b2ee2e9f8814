"""CoACD in a process of its own: `python -m sensors.physics.coacd_process IN OUT`.

It is native code that may abort on a mesh, take minutes or talk to the terminal; none of that
reaches who called. IN holds `vertices`, `faces`, `preprocess`, `threshold`; OUT gets the corners of
all parts, one after the other, as `vertices`, and how many each part has as `sizes`. When standard
input ends before that, the caller died: the process ends, too, and removes the folder of OUT.
"""

from __future__ import annotations

import os
import shutil
import sys
import threading
from pathlib import Path

import numpy as np

# Fast settings: a bowl takes 2 s of processor time, a mug 4 s; a surface that is not closed, which
# has to be remeshed first, 8 s at this resolution and 16 s at 30. Looking further ahead for cuts
# (a depth of 3) took half as long again and gave bowls with more room, not less.
SETTINGS = {
    "max_convex_hull": 32,
    "preprocess_resolution": 20,
    "resolution": 500,
    "mcts_nodes": 5,
    "mcts_iterations": 6,
    "mcts_max_depth": 1,
    "seed": 1,
}


def main(source: str, target: str) -> None:
    import coacd

    coacd.set_log_level("error")
    with np.load(source, allow_pickle=False) as data:
        mesh = coacd.Mesh(data["vertices"], data["faces"])
        preprocess, threshold = str(data["preprocess"]), float(data["threshold"])
    parts = coacd.run_coacd(mesh, preprocess_mode=preprocess, threshold=threshold, **SETTINGS)
    corners = [np.asarray(vertices, dtype=np.float64) for vertices, _ in parts]
    np.savez(target, vertices=np.concatenate(corners), sizes=np.array([len(c) for c in corners]))


def _end_with_caller(folder: Path) -> None:
    # Not through sys.stdin: a thread that waits in it makes Python abort when it ends.
    while os.read(0, 1024):
        pass
    shutil.rmtree(folder, ignore_errors=True)
    os._exit(1)


if __name__ == "__main__":
    # A file name without this suffix would get it from numpy.
    assert Path(sys.argv[2]).suffix == ".npz"
    folder = Path(sys.argv[2]).parent
    threading.Thread(target=_end_with_caller, args=(folder,), daemon=True).start()
    main(sys.argv[1], sys.argv[2])
