"""Results of the stages of a scan, kept with the digest of all that determines them.

A stage whose inputs are unchanged is read instead of computed, so an interrupted scan resumes.
Files are written atomically.
"""

from __future__ import annotations

import zipfile
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from std_toolkit.io.atomic import atomic_path
from std_toolkit.log import logger

Arrays = Mapping[str, Any]


@dataclass(frozen=True)
class Stages:
    """Folder of finished stages."""

    folder: Path

    def arrays(
        self, name: str, digest: str, make: Callable[[], Arrays], *, quiet: bool = False
    ) -> Arrays:
        """The arrays of a stage: read if they are there with this digest, else made and kept.

        Args:
            name: name of the stage; older results of it are removed.
            digest: of the inputs and options of the stage.
            make: computes the arrays.
            quiet: whether a result that is read is not mentioned.
        """
        path = self.folder / f"{name}-{digest[:16]}.npz"
        kept = _read(path)
        if kept is not None:
            if not quiet:
                logger.info("%s: as in the last run", name)
            return kept
        made = make()
        with atomic_path(path) as temporary:
            np.savez(temporary, **made)
        for old in self.folder.glob(f"{name}-*.npz"):
            if old != path:
                old.unlink(missing_ok=True)
        return made


def _read(path: Path) -> Arrays | None:
    """Arrays of a file; None if it does not exist or is damaged."""
    try:
        with np.load(path, allow_pickle=False) as data:
            return {key: data[key] for key in data.files}
    except FileNotFoundError:
        return None
    except (OSError, ValueError, EOFError, zipfile.BadZipFile) as error:
        logger.warning("%s is damaged and made again: %s", path, error)
        return None
