"""Writing labelled scenes in the layouts that other tools read."""

from std_toolkit.exporters.protocol import EXPORTERS, Exporter, ExportOptions
from std_toolkit.exporters.run import export_scene

__all__ = ["EXPORTERS", "ExportOptions", "Exporter", "export_scene"]
