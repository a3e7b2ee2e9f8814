"""Reading recordings of other formats into scenes."""

from std_toolkit.importers.protocol import IMPORTERS, Importer, ImportRequest, detect_format
from std_toolkit.importers.run import import_recording

__all__ = ["IMPORTERS", "ImportRequest", "Importer", "detect_format", "import_recording"]
