"""CoACD in a separate process: `python -m sensors.physics.coacd_process IN OUT SECONDS`.

CoACD is native code that may abort on a mesh, run for minutes or print to the terminal; a separate
process isolates the caller from this. IN contains `vertices`, `faces`, `preprocess`, `threshold`.
OUT receives the corners of all parts, concatenated, as `vertices`, and the number of corners of
each part as `sizes`. After SECONDS of processor time the process is killed. If standard input
closes earlier, the caller died: the process then ends and removes the folder of OUT.
"""

import os
import resource
import shutil
import sys
import threading
from pathlib import Path

import numpy as np

# Fast settings: a bowl takes 2 s of processor time, a mug 4 s; a surface that is not closed and is
# remeshed first takes 8 s at this resolution and 16 s at 30. A deeper search for cuts (depth 3)
# took 50 % longer and gave bowls with more room, not less.
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
    # Not through sys.stdin: a thread blocked in it makes Python abort at exit.
    while os.read(0, 1024):
        pass
    shutil.rmtree(folder, ignore_errors=True)
    os._exit(1)


if __name__ == "__main__":
    # numpy appends this suffix to a file name without it.
    assert Path(sys.argv[2]).suffix == ".npz"
    seconds = int(sys.argv[3])
    # A soft limit sends SIGXCPU, by which the caller knows the reason.
    _, most = resource.getrlimit(resource.RLIMIT_CPU)
    hard = seconds + 5 if most == resource.RLIM_INFINITY else min(most, seconds + 5)
    resource.setrlimit(resource.RLIMIT_CPU, (min(seconds, hard), hard))
    folder = Path(sys.argv[2]).parent
    threading.Thread(target=_end_with_caller, args=(folder,), daemon=True).start()
    main(sys.argv[1], sys.argv[2])
