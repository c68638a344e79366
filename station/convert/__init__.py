"""Records from elsewhere into recordings, and recordings into the files that others read."""

from station.convert.exporter import Format, export
from station.convert.importers import IMPORTERS, Importer, Reader, import_file, reader_of
from station.convert.tracks import Record, Track

__all__ = ["IMPORTERS", "Format", "Importer", "Reader", "Record", "Track", "export", "import_file", "reader_of"]
