"""Recordings: MCAP files of raw bytes, rows, estimates and events, with profiles and versions inside.

A recording is one file, name.mcap, and where it outgrows the card's limit name.0001.mcap, name.0002.mcap and so on,
each complete in itself.
"""

from station.log.about import About, LogInfo
from station.log.arithmetic import arithmetic, unlike
from station.log.disk import make_folder
from station.log.reading import metadata, parts, read_rows, row_times
from station.log.summary import Summary, describe, in_words, recover, span_ns, summarise, verdict
from station.log.table import Point, Table, points, table
from station.log.writer import LogWriter, write_log
from station.log.writer_thread import WriterThread

__all__ = [
    "About",
    "LogInfo",
    "LogWriter",
    "Point",
    "Summary",
    "Table",
    "WriterThread",
    "arithmetic",
    "describe",
    "in_words",
    "make_folder",
    "metadata",
    "parts",
    "points",
    "read_rows",
    "recover",
    "row_times",
    "span_ns",
    "summarise",
    "table",
    "unlike",
    "verdict",
    "write_log",
]
