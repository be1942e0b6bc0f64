"""The declarations of tables: what follows from them, and that they name who fills them."""

from functools import reduce
from importlib import import_module

import pytest

from ssduck.schema import FRAMES, HISTORIES, MODELS, RECORDED, TABLES

ALL = {**TABLES, **RECORDED}


@pytest.mark.parametrize("name", ALL)
def test_a_table_names_the_functions_that_fill_it(name):
    assert ALL[name].filled_by
    for path in ALL[name].filled_by:
        package, module, *parts = path.split(".")
        home = import_module(f"ssduck.{package}.{module}")
        assert callable(reduce(getattr, parts, home))


@pytest.mark.parametrize("name", ALL)
def test_the_columns_of_a_table_are_declared_once(name):
    table = ALL[name]
    names = [column.name for column in table.all_columns]
    assert len(set(names)) == len(names)
    assert {*table.key, *table.entity_columns} <= set(names)


@pytest.mark.parametrize("name", RECORDED)
def test_rows_of_ticks_begin_with_the_tick_and_its_time(name):
    columns = RECORDED[name].tick_columns
    assert (columns.integers[0], columns.doubles[0]) == ("tick", "time")


@pytest.mark.parametrize("name", HISTORIES)
def test_a_history_has_each_column_in_its_rows_or_in_its_model(name):
    table = RECORDED[HISTORIES[name].source]
    stored = {*table.tick_columns.names, *(column.name for column in table.model)}
    assert set(table.names) <= stored
    if table.model:
        assert set(table.key) <= {column.name for column in MODELS[table.name].model}


def test_the_poses_of_links_are_for_records_alone():
    assert FRAMES not in TABLES
    assert FRAMES not in HISTORIES
