"""What results know of their data: its digest, how many frames there are, where they come from."""

from collections.abc import Sequence
from dataclasses import dataclass, field

import msgspec
import pandas as pd

from benchmark.data.identity import data_digest, groups_of
from benchmark.data.provenance import Provenance
from benchmark.data.splits import get_split, splits

DATA_FILE, CONTENT_FILE = "data.json", "data.parquet"


class DataRecord(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """data.json of a run.

    Attributes:
        digest: of all content that the run read, without answers of methods.
        frames: number of frames of the split in the root folder, which the run may take a part of.
        provenance: where the frames come from.
    """

    digest: str
    frames: int
    provenance: Provenance = Provenance()


@dataclass(frozen=True, eq=False)
class KnownData:
    """The data of results that were read.

    Attributes:
        record: None for results of earlier versions.
        content: its table, or None.
    """

    record: DataRecord | None = None
    content: pd.DataFrame | None = field(default=None, repr=False)

    @property
    def provenance(self) -> Provenance:
        """Where the frames come from."""
        return Provenance() if self.record is None else self.record.provenance

    @property
    def origin(self) -> str:
        """Where the frames come from, in a word or two."""
        kind = self.provenance.kind
        return "provenance unknown" if kind == "unknown" else kind

    def named(self, split: str) -> str:
        """Return the name of a split on pages: simulated frames do not bear a published name."""
        # A name such as `module:SPLIT` comes from a result file: do not import it.
        has_page = split in splits.names() and bool(get_split(split).page)
        return f"std-sim:{split}" if has_page and self.provenance.kind == "simulated" else split

    @property
    def is_published(self) -> bool:
        """Whether the frames are the published ones, so that published figures are comparable."""
        return self.provenance.kind == "published"


def names_of_data(names: Sequence[str], data: Sequence[KnownData]) -> list[str]:
    """Return the name of the data set of each result, others for other content.

    Args:
        names: of the splits on pages.
        data: of the results.
    """
    found = list(names)
    for name in dict.fromkeys(names):
        mine = [i for i, other in enumerate(names) if other == name]
        groups = groups_of([data[i].content for i in mine])
        if len(set(groups)) == 1:
            continue
        for i, group in zip(mine, groups, strict=True):
            first = data[mine[groups.index(group)]].content
            found[i] = f"{name}@{'unknown' if first is None else data_digest(first)[:6]}"
    return found


def published_size(split: str) -> int:
    """Return the smallest published number of frames of a split; 0 if none is published."""
    # A name such as `module:SPLIT` comes from a result file: do not import it.
    known = get_split(split).published if split in splits.names() else ()
    return min((p.frames for p in known if not p.of_more), default=0)
