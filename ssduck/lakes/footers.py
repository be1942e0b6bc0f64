"""Compares what the footers of episodes say of values with the values, for statements over them.

Whoever runs a statement leaves rows out by the footers (`recording.stores.part_statistics`).
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from contextlib import closing

from ssduck.database.database import Database
from ssduck.lakes.workers import UNREADABLE
from ssduck.recording.opened_record import OpenedRecord
from ssduck.recording.stores.base import StoreConnection
from ssduck.recording.stores.parquet_layout import FolderRun
from ssduck.recording.stores.part_statistics import check_statistics

# The tables that statements read.
_TABLES = ("ticks", "entities")


def footer_errors(runs: Mapping[int, FolderRun]) -> dict[int, Exception]:
    """Returns why the footers of episodes cannot be relied on, of those whose cannot.

    Args:
        runs: the episodes, by any numbers.
    """
    errors: dict[int, Exception] = {}
    records: dict[tuple[str, str], dict[int, FolderRun]] = {}
    for number, run in runs.items():
        records.setdefault((str(run.path), run.world), {})[number] = run
    with closing(Database(":memory:", None)) as database:
        for own in records.values():
            connection = database.connection.reader(OpenedRecord(next(iter(own.values())).path))
            with closing(connection):
                errors |= _errors_of_record(connection, own)
    return errors


def _errors_of_record(
    connection: StoreConnection, runs: Mapping[int, FolderRun]
) -> dict[int, Exception]:
    """Returns the errors of episodes of one world in a record."""
    errors: dict[int, Exception] = {}
    try:
        _compare(connection, runs.values())
    except UNREADABLE:
        for number, run in runs.items():
            try:
                _compare(connection, [run])
            except UNREADABLE as error:
                errors[number] = error
    return errors


def _compare(connection: StoreConnection, runs: Iterable[FolderRun]) -> None:
    for table in _TABLES:
        files = [file for run in runs for file in run.listed_files(table)]
        if files:
            check_statistics(connection, files, table)
