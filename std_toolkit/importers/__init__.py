"""Reading recordings of other formats into scenes."""

from std_toolkit.importers.import_step import import_recording
from std_toolkit.importers.importer import IMPORTERS, Importer, detect_format
from std_toolkit.options import ImportRequest

__all__ = ["IMPORTERS", "ImportRequest", "Importer", "detect_format", "import_recording"]
