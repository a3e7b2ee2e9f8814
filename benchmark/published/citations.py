"""`citations.bib`: what to cite for methods, data sets and protocols that a run used."""

import json
import re
from collections.abc import Iterable, Sequence
from functools import cache
from pathlib import Path

from std_toolkit import __version__
from std_toolkit.errors import ToolkitError
from std_toolkit.io.atomic import write_bytes_atomic

NAME = "citations.bib"
_FILE = Path(__file__).with_name(NAME)

# Names of the command line, and the entries of `citations.bib` that describe them. What has none
# (`nearest`, `scenes`) has no paper of its own.
KEYS: dict[str, tuple[str, ...]] = {
    # Depth restorers.
    "navier-stokes": ("bertalmio2001",),
    "telea": ("telea2004",),
    "joint-bilateral": ("kopf2007joint",),
    "colorization": ("levin2004colorization",),
    "swindrnet": ("dai2022dreds",),
    "nlspn": ("park2020nlspn",),
    "lidf": ("zhu2021lidf",),
    "cleargrasp": ("sajjan2020cleargrasp",),
    "dfnet": ("fang2022transcg",),
    "stereo-local": ("zabih1994census",),
    "stereo-sgbm": ("hirschmueller2008sgm",),
    "stereo-dreds": ("dai2022dreds",),
    "compactdr": ("tan2019efficientnet",),
    "std-restore": ("dai2022dreds", "tan2019efficientnet"),
    "two-branch": ("dai2022dreds", "qi2017pointnetpp"),
    "prompt-depth-anything": ("lin2025promptda",),
    "depth-anything": ("yang2024depthanything",),
    "depth-pro": ("bochkovskii2025depthpro",),
    "zoedepth": ("bhat2023zoedepth",),
    # Pose and grasp methods.
    "nocs": ("wang2019nocs",),
    "crop-nocs": ("wang2019nocs",),
    "spd": ("tian2020spd",),
    "sgpa": ("chen2021sgpa",),
    "swindrnet-nocs": ("dai2022dreds",),
    "graspnet": ("fang2020graspnet",),
    "flat-patches": ("mahler2018dexnet", "cao2021suctionnet"),
    # Data sets.
    "dreds-catknown-train": ("dai2022dreds",),
    "dreds-catknown-val": ("dai2022dreds",),
    "dreds-catknown-test": ("dai2022dreds",),
    "dreds-catnovel": ("dai2022dreds",),
    "std-catknown": ("dai2022dreds",),
    "std-catnovel": ("dai2022dreds",),
    "cleargrasp-real-known": ("sajjan2020cleargrasp",),
    "cleargrasp-real-novel": ("sajjan2020cleargrasp",),
    "cleargrasp-synthetic": ("sajjan2020cleargrasp",),
    **{
        f"hammer-{s}-{p}": ("jung2023hammer",)
        for s in ("d435", "l515", "tof")
        for p in ("test", "train")
    },
    **{
        f"clearpose-{part}": ("chen2022clearpose",)
        for part in (
            "train",
            "test",
            "heavy-occlusion",
            "new-background",
            "opaque-distractor",
            "translucent-cover",
            "non-planar",
            "filled-liquid",
        )
    },
    **{
        f"transcg-{s}-{p}": ("fang2022transcg",)
        for s in ("d435", "l515")
        for p in ("test", "test-2022-10", "train")
    },
    **{f"xyzibd-val-{s}": ("xyzibd2025",) for s in ("realsense", "xyz", "photoneo")},
    "ipd-val-photoneo": ("kalra2024ipd",),
    **{
        f"pace-{part}": ("you2024pace",)
        for part in ("test", "val-inst", "val-pbr-cat", "train-pbr-cat", "train-pbr-inst")
    },
    **{f"housecat6d-{part}": ("jung2024housecat6d",) for part in ("train", "val", "test")},
    **{f"phocal-{part}": ("wang2022phocal",) for part in ("train", "test")},
    "robi-ensenso": ("yang2021robi",),
    **{
        f"transpose-{s}-{p}": ("kim2024transpose",)
        for s in ("right", "left")
        for p in ("test", "train")
    },
    **{f"syn-todd-{p}": ("wang2023mvtrans",) for p in ("train", "val", "test", "rendered")},
    **{f"todd-{p}": ("xu2021seeing",) for p in ("train", "val", "test")},
    **{
        f"gn-trans-{p}": ("shi2024asgrasp", "fang2020graspnet")
        for p in ("train", "test-seen", "test-similar", "test-novel")
    },
    **{f"real275-{part}": ("wang2019nocs",) for part in ("test", "train")},
    **{f"camera25-{part}": ("wang2019nocs",) for part in ("val", "train")},
    # Protocols; that of ClearGrasp has the name of its method.
    "paper": ("dai2022dreds",),
    "transcg": ("fang2022transcg",),
    "transcg-2022-10": ("fang2022transcg",),
    "clearpose": ("chen2022clearpose",),
    "bop": ("hodan2018bop",),
}
# Fields of a run's setup that name what was used.
_FIELDS = ("method", "split", "protocol", "depth", "planner")


@cache
def entries() -> dict[str, str]:
    """BibTeX entries by key, in the order of the file."""
    text = _FILE.read_text(encoding="utf-8")
    found = re.findall(r"^@\w+\{([^,]+),\n.*?^\}\n", text, re.S | re.M)
    whole = re.findall(r"^@\w+\{[^,]+,\n.*?^\}\n", text, re.S | re.M)
    return dict(zip(found, whole, strict=True))


def citations(names: Iterable[str], more: Iterable[str] = ()) -> str:
    """The text of a `citations.bib`: this toolkit, and the sources of what was used.

    Args:
        names: methods, splits and protocols as named on the command line; each once, in this order.
        more: BibTeX or lines of others, which become comments.

    >>> print(citations(["swindrnet", "nearest"]).splitlines()[0])
    % std-toolkit
    """
    used: dict[str, list[str]] = {}
    for name in dict.fromkeys(names):
        for key in KEYS.get(name, ()):
            used.setdefault(key, []).append(name)
    own = (
        "% std-toolkit\n@software{std_toolkit,\n"
        "  author = {{The std-toolkit developers}},\n"
        "  title = {std-toolkit: RGB-D data sets of specular, transparent and diffuse objects},\n"
        f"  version = {{{__version__}}}\n}}\n"
    )
    parts = [own, *(f"% {', '.join(by)}\n{entries()[key]}" for key, by in used.items())]
    for text in dict.fromkeys(text.strip() for text in more):
        is_entry = text.startswith("@")
        parts.append(text + "\n" if is_entry else "".join(f"% {x}\n" for x in text.splitlines()))
    return "\n".join(parts)


def write_citations(folder: Path, names: Iterable[str], more: Iterable[str] = ()) -> None:
    """Write `citations.bib`; see `citations`.

    Raises:
        ToolkitError: it cannot be written.
    """
    write_bytes_atomic(folder / NAME, citations(names, more).encode())


def names_of_runs(folders: Sequence[Path], manifests: Sequence[str]) -> list[str]:
    """Methods, splits and protocols of all runs in folders of results.

    Args:
        manifests: names of the files that describe a run.

    Raises:
        ToolkitError: such a file cannot be read.
    """
    names: list[str] = []
    for folder in folders:
        for manifest in manifests:
            for path in sorted(folder.rglob(manifest)):
                try:
                    setup = json.loads(path.read_text(encoding="utf-8")).get("setup", {})
                except (OSError, ValueError, AttributeError) as error:
                    raise ToolkitError("cannot be read", path=path) from error
                names += [setup[f] for f in _FIELDS if isinstance(setup.get(f), str)]
                if "bop" in manifest:
                    names.append("bop")
    return names
