"""Pictures of a few frames of a run: best, median and worst frame of the method, and three frames
that are the same for all methods."""

from collections.abc import Sequence
from pathlib import Path

import msgspec
import numpy as np
import pandas as pd

from benchmark.evaluation.batches import chosen_frames
from benchmark.evaluation.depth_panels import LARGEST_ERROR_M, depth_scale, strip
from benchmark.evaluation.frames import FrameRun
from benchmark.evaluation.results import ERROR, INDEX, TABLE, read_table
from benchmark.methods.depth.full_size import restorer_view
from benchmark.methods.protocol import Restorer
from benchmark.metrics.protocols.protocol import get_protocol
from std_toolkit.io.documents import read_document, write_document
from std_toolkit.io.images import write_color

FOLDER = "gallery"
INDEX_FILE = "gallery.json"
# Root mean squared error including pixels without a prediction, as in the ranking of methods.
RANKED_BY = "rmse"
COMMON = 3


class GalleryPicture(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """One frame.

    Attributes:
        rank: `best`, `median`, `worst`, or `common` for the frames shown for every method.
        scene, frame: names of scene and frame.
        rmse: metres, on the main grid and subset of the protocol.
        picture: file name; its panels are those of `PANELS`, and `TRUST_PANEL` if `trust`.
        near, far: depth at the ends of the colour map, metres.
        largest_error: error at the end of the colour map, metres.
        trust: whether the method's confidence in the sensor is shown; never for `common`, since
            most methods have none.
    """

    rank: str
    scene: str
    frame: str
    rmse: float
    picture: str
    near: float
    far: float
    largest_error: float = LARGEST_ERROR_M
    trust: bool = False


class Gallery(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """All pictures of a run."""

    pictures: list[GalleryPicture]


def make_gallery(run: FrameRun[Restorer], protocol_name: str) -> Gallery:
    """Restore the frames of the gallery again and save their pictures in the folder of the run.

    Raises:
        ToolkitError: a picture cannot be written.
    """
    protocol = get_protocol(protocol_name)
    table = read_table(run.folder / TABLE)
    source, restorer = run.open(), run.make(run.devices[0])
    common = run.pictured(source)
    if not common:
        common = run.chosen(source)
        common = [common[i] for i in chosen_frames(len(common), COMMON)]
    frames = gallery_frames(table, protocol.main, common)
    pictures = []
    for rank, index, rmse in frames:
        frame = run.load(source, index)
        restored = restorer.restore([restorer_view(frame, restorer, protocol.view_size)])[0]
        name = f"{rank}-{index:07d}.jpg"
        trust = None if rank == "common" else restored.confidence
        write_color(run.folder / FOLDER / name, strip(frame, restored.depth, trust), quality=88)
        scale = depth_scale(frame)
        pictures.append(
            GalleryPicture(
                rank=rank,
                scene=frame.scene,
                frame=frame.name,
                rmse=rmse,
                picture=name,
                near=scale.near,
                far=scale.far,
                trust=trust is not None,
            )
        )
    gallery = Gallery(pictures=pictures)
    write_document(run.folder / FOLDER / INDEX_FILE, gallery)  # last: marks the gallery complete
    return gallery


def shows(folder: Path, wanted: Sequence[str]) -> bool:
    """Whether the gallery of a run is there, and has pictures of the wanted frames.

    Args:
        folder: of the run.
        wanted: SCENE/FRAME of the common frames; empty for any.

    Raises:
        ToolkitError: its index is damaged.
    """
    path = folder / FOLDER / INDEX_FILE
    if not path.exists() or not wanted:
        return path.exists()
    pictures = read_document(path, Gallery).pictures
    return {f"{p.scene}/{p.frame}" for p in pictures if p.rank == "common"} == set(wanted)


def gallery_frames(
    table: pd.DataFrame, main: tuple[str, str], common: list[int]
) -> list[tuple[str, int, float]]:
    """Return rank, index and RMSE of the frames to show.

    Args:
        table: rows of a run.
        main: grid and subset that methods are ranked by.
        common: frames shown for every method; those that could not be scored are skipped.
    """
    grid, subset = main
    scored = table[(table["grid"] == grid) & (table["subset"] == subset) & (table[ERROR] == "")]
    scored = scored[scored["n_pixels"] > 0]
    if scored.empty:  # a table of failed frames alone has no figures
        return []
    scored = scored.sort_values([RANKED_BY, INDEX], kind="stable")
    value = dict(zip(scored[INDEX].tolist(), scored[RANKED_BY].tolist(), strict=True))
    order = scored[INDEX].to_numpy()
    places = {"best": 0, "median": (len(order) - 1) // 2, "worst": len(order) - 1}
    shown = [(rank, int(order[place])) for rank, place in places.items()]
    shown += [("common", index) for index in common if index in value]
    return [(rank, index, float(np.float64(value[index]))) for rank, index in shown]
