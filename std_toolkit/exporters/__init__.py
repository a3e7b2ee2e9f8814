"""Export of labelled scenes in the layouts of other tools."""

from std_toolkit.exporters.export_step import export_scene
from std_toolkit.exporters.exporter import EXPORTERS, Exporter
from std_toolkit.options import ExportOptions

__all__ = ["EXPORTERS", "ExportOptions", "Exporter", "export_scene"]
