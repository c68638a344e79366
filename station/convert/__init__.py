"""Records from elsewhere into recordings, and recordings into the files that others read."""

from station.convert.exporter import Format, export
from station.convert.importers import CH10, IMPORTERS, Importer, Reader, ch10_rows, import_file, reader_of
from station.convert.tracks import Record, Track

__all__ = [
    "CH10",
    "IMPORTERS",
    "Format",
    "Importer",
    "Reader",
    "Record",
    "Track",
    "ch10_rows",
    "export",
    "import_file",
    "reader_of",
]
