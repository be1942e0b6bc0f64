"""Turns values into JSON and a body of bytes, and back: nothing that is sent is run.

JSON holds nothing, numbers, texts and lists as they are; everything else is an object of one key,
its *tag*. Many numbers, long texts, arrays and tables are in the body, and the JSON says where.
"""

from __future__ import annotations

import datetime as dt
import json
import math
from collections.abc import Callable, Sequence
from dataclasses import fields
from decimal import Decimal
from functools import cache
from itertools import chain
from operator import itemgetter
from typing import Any
from uuid import UUID

import numpy as np
import pyarrow as pa

from ssduck.adapters.grid_values import OccupancyGrid, PlaneGrid, SensorGrid, VoxelGrid
from ssduck.adapters.optional import library
from ssduck.adapters.result import Result
from ssduck.adapters.tabular import class_of_rows
from ssduck.errors import LimitError, SelectScriptError, UnsupportedError
from ssduck.logic.why import Move, Why
from ssduck.sandbox.budget import ELEMENT, Budget, InvalidAnswerError, is_short
from ssduck.sandbox.references import EntityReference, SandboxedWorld
from ssduck.sandbox.tables import checked_table, plain_table, size_of_values, table_bytes
from ssduck.world.handles import Handle
from ssduck.world.world import World

# Lists of so many numbers, and texts of so many characters, are in the body.
_LEAST_PACKED, _LEAST_TEXT = 16, 1000
# Each part of the body begins at a multiple of this, bytes.
_ALIGNMENT = 64
# What a dict takes beside its values, bytes.
_DICT = 360
_MAX_DEPTH, _MAX_NAMES = 100, 1000
# How long the largest integer of the language is, of a million bits, in hexadecimal digits.
_MAX_INTEGER = len("-0x") + 10**6 // 4
# The classes of graphs, and what a node and an edge take beside their attributes, bytes.
_GRAPHS, _NODE, _EDGE = ("EntityGraph", "EntityMultiGraph"), 1000, 1000
# The kinds of numpy's types: of numbers, truth values, texts and times.
_KINDS = "biufcUSMm"
_MODES = {"1": 1, "L": 1, "RGB": 3, "RGBA": 4}
_OBJECTS: dict[str, type[Any]] = {
    kind.__name__: kind for kind in (OccupancyGrid, PlaneGrid, SensorGrid, VoxelGrid, Why, Move)
}
_json = json.JSONEncoder(separators=(",", ":")).encode
_PLAIN = frozenset((type(None), bool, int, float, str))


class Encoder:
    """Turns values into JSON and the parts of a body.

    Args:
        budget: counts what the receiver takes for them.
        name: returns the name of a world by which the other side knows it.

    Attributes:
        parts: the parts of the body, in order.
    """

    def __init__(self, budget: Budget, name: Callable[[Any], str]) -> None:
        self.parts: list[bytes | memoryview] = []
        self._name = cache(name)  # entities are many
        self._size = 0
        self._budget = budget

    def text(self, value: Any) -> bytes:
        """Returns the JSON of a value."""
        text = _json(self.node(value)).encode()
        self._budget.charge_json(text)
        return text

    def node(self, value: Any, depth: int = 0) -> Any:
        """Returns what JSON holds of a value."""
        kind = type(value)
        if kind in _PLAIN:
            if kind is str and len(value) >= _LEAST_TEXT:
                data = value.encode("utf-8", "surrogatepass")
                self._budget.charge_text(data)
                return {"text": self._part(data)}
            if kind is int and not is_short(value):
                return {"int": hex(value)}
            return value
        if depth > _MAX_DEPTH:
            raise LimitError(f"a value is nested more than {_MAX_DEPTH} times")
        if kind is list:
            return self._list(value, depth + 1)
        if kind is dict:
            self._budget.charge_keys(value)
            pairs = [[key, part] for key, part in value.items()]
            return {"dict": self._each(chain.from_iterable(pairs), depth + 1)}
        for base, tag, encode in _ENCODERS:
            if isinstance(value, base):
                return {tag: encode(self, value, depth + 1)}
        raise AssertionError("the last encoder is of any object")

    def _each(self, values: Any, depth: int) -> list[Any]:
        return [self.node(one, depth) for one in values]

    def _part(self, data: bytes | memoryview) -> list[int]:
        """Adds a part to the body, and returns its place and its size."""
        place, size = self._size, len(data)
        padding = -size % _ALIGNMENT
        self._budget.charge(size + padding)
        self.parts += [data, bytes(padding)]
        self._size += size + padding
        return [place, size]

    def _list(self, values: list[Any], depth: int) -> Any:
        if len(values) < _LEAST_PACKED:
            return self._each(values, depth)
        kinds = set(map(type, values))
        if kinds == {dict} and (columns := _columns(values)) is not None:
            self._budget.charge((_DICT + ELEMENT * len(columns)) * len(values))
            self._budget.charge_keys(columns, len(values))
            encoded = [self._list(column, depth) for column in columns.values()]
            return {"rows": [len(values), self._each(columns, depth), encoded]}
        if kinds == {list} and len(widths := set(map(len, values))) == 1 and widths != {0}:
            flat = list(chain.from_iterable(values))
            if (packed := self._packed(flat, set(map(type, flat)))) is not None:
                self._budget.charge(ELEMENT * 2 * len(values))
                return {"lists": [*widths, packed]}
        packed = self._packed(values, kinds)
        return self._each(values, depth) if packed is None else packed

    def _packed(self, values: list[Any], kinds: set[type]) -> Any:
        """Returns a list of floats, of integers or of entities as numbers; None if it is none."""
        if all(issubclass(kind, Handle) for kind in kinds):
            keys = [(one.id, one.moment, one.world) for one in values]
            distinct = dict(zip(keys, values, strict=True))
            places = {key: place for place, key in enumerate(distinct)}
            numbers = self._list([places[key] for key in keys], 0)
            return {"entities": [[self.entity(one, 0) for one in distinct.values()], numbers]}
        if kinds not in ({float}, {int}):
            return None
        try:
            array = np.array(values, np.float64 if kinds == {float} else np.int64)
        except OverflowError:
            return None
        self._budget.charge(ELEMENT * len(values))
        return {"numbers": [array.dtype.str, self._part(array.data.cast("B"))]}

    def array(self, array: np.ndarray[Any, Any], depth: int) -> Any:
        """Returns what JSON holds of an array."""
        shape = list(array.shape)
        if array.dtype.names is not None:
            parts = [[name, self.array(array[name], depth + 1)] for name in array.dtype.names]
            return ["fields", shape, parts]
        if array.dtype.kind in _KINDS:
            return [array.dtype.str, shape, self._part(array.tobytes())]
        return ["objects", shape, self._list(array.ravel().tolist(), depth + 1)]

    def row(self, row: Any, depth: int) -> Any:
        """Returns what JSON holds of a tuple, or of a named one."""
        names = getattr(row, "_fields", ())
        self._budget.charge_class(names)
        return [list(names), self._each(row, depth)]

    def table(self, table: pa.Table, _: int) -> Any:
        """Returns the place of a table."""
        return self._part(table_bytes(table))

    def entity(self, entity: Any, depth: int) -> Any:
        """Returns what JSON holds of an entity, or of a reference to one."""
        if isinstance(entity, EntityReference):
            world, tick = entity.world, entity.tick
        else:
            world, tick = self._name(entity.world), entity.moment and entity.moment.tick
        names = entity.name, entity.kind, tick, entity.full_name
        return self._each([world, entity.id, *names], depth)

    def object(self, value: Any, depth: int) -> Any:
        """Returns what JSON holds of a grid, or of what tells why a condition holds."""
        parts = [[field.name, getattr(value, field.name)] for field in fields(value)]
        return [type(value).__name__, [[name, self.node(part, depth)] for name, part in parts]]

    def other(self, value: Any, depth: int) -> Any:
        """Returns what JSON holds of a frame, a graph or a picture: their classes come late."""
        library = type(value).__module__.partition(".")[0]
        if library == "PIL" and value.mode in _MODES:
            return ["picture", value.mode, *value.size, self._part(memoryview(value.tobytes()))]
        if type(value).__name__ in _GRAPHS and library == "ssduck":
            is_multi = value.is_multigraph()
            edges = value.edges(keys=True, data=True) if is_multi else value.edges(data=True)
            parts = [list(value.nodes(data=True)), [list(edge) for edge in edges]]
            return ["graph", type(value).__name__, self._each(parts, depth + 1)]
        if library == "pandas" and type(value).__name__ == "DataFrame":
            table = plain_table(pa.Table.from_pandas(value, preserve_index=False))
            self._budget.charge(size_of_values(table))
            return ["pandas", list(map(str, value.dtypes)), self.table(table, depth)]
        if library == "polars" and type(value).__name__ == "DataFrame":
            return ["polars", [], self.table(value.to_arrow(), depth)]
        raise UnsupportedError(
            f"a value of the class {type(value).__name__} cannot cross the wall of the sandbox; "
            "numbers, texts, lists, dicts, arrays and tables do: AS dict, list, df, numpy or json"
        )


def _columns(rows: list[dict[Any, Any]]) -> dict[Any, list[Any]] | None:
    """Returns the values of dicts by their keys; None if these differ."""
    if set(map(len, rows)) != {len(rows[0])}:
        return None
    try:
        return {key: list(map(itemgetter(key), rows)) for key in rows[0]}
    except KeyError:
        return None


_ENCODERS: tuple[tuple[Any, str, Callable[[Encoder, Any, int], Any]], ...] = (
    (np.generic, "scalar", lambda self, one, depth: self.array(np.asarray(one), depth)),
    (np.ndarray, "array", Encoder.array),
    (tuple, "tuple", Encoder.row),
    (list, "list", lambda self, value, depth: self._each(value, depth)),
    ((Handle, EntityReference), "entity", Encoder.entity),
    ((World, SandboxedWorld), "world", lambda self, world, _: self._name(world)),
    (Result, "result", lambda self, result, depth: self.table(result.arrow(), depth)),
    (pa.Table, "table", Encoder.table),
    (tuple(_OBJECTS.values()), "object", Encoder.object),
    (bytes | bytearray, "bytes", lambda self, data, _: self._part(bytes(data))),
    (dt.datetime, "datetime", lambda _self, value, _: value.isoformat()),
    (dt.date, "date", lambda _self, value, _: value.isoformat()),
    (dt.time, "time", lambda _self, value, _: value.isoformat()),
    (dt.timedelta, "duration", lambda _s, v, _: [v.days, v.seconds, v.microseconds]),
    (Decimal, "decimal", lambda _self, value, _: str(value)),
    (UUID, "uuid", lambda _self, value, _: str(value)),
    (object, "other", Encoder.other),
)


class Decoder:
    """Makes values of JSON and a body.

    Args:
        body: the body.
        budget: counts what the values take; the body has been counted.
        entity: returns the entity of a world, a number, a name, a kind, a tick and a full name.
        world: returns the world of a name.
        table: returns the table of some bytes.
    """

    def __init__(
        self,
        body: memoryview,
        budget: Budget,
        *,
        entity: Callable[..., Any] = EntityReference,
        world: Callable[[str], Any],
        table: Callable[[memoryview, Budget], pa.Table] = checked_table,
    ) -> None:
        self._body = body
        self._taken = 0
        self._budget = budget
        self._entity = entity
        self._world = world
        self._table = table

    def value(self, document: bytes) -> Any:
        """Returns the value of a text of JSON."""
        try:
            return self.node(self._budget.parsed(document))
        except (InvalidAnswerError, SelectScriptError):
            raise
        except Exception as error:
            raise InvalidAnswerError(f"{type(error).__name__}: {error}") from error

    def node(self, node: Any) -> Any:
        """Returns the value of what JSON holds of it."""
        kind = type(node)
        if kind is list:
            is_plain = _PLAIN.issuperset(map(type, node))
            return node if is_plain else [self.node(part) for part in node]
        if kind is not dict:
            return node
        ((tag, content),) = node.items()
        return _DECODERS[tag](self, content)

    def part(self, place: Any) -> memoryview:
        """Returns a part of the body."""
        start, size = place
        if not (0 <= start <= start + size <= len(self._body)):
            raise InvalidAnswerError("a part lies outside its body")
        self._taken += size
        if self._taken > len(self._body):
            raise InvalidAnswerError("a part of its body stands for several values")
        return self._body[start : start + size]

    def integer(self, content: Any) -> int:
        """Returns a large integer."""
        if len(content) > _MAX_INTEGER:
            raise InvalidAnswerError("an integer is too large")
        return int(content, 16)

    def numbers(self, content: Any) -> list[Any]:
        """Returns a list of numbers."""
        kind, place = content
        if kind not in ("<f8", "<i8"):
            raise InvalidAnswerError("a list is of no numbers")
        data = np.frombuffer(self.part(place), kind)
        self._budget.charge(ELEMENT * len(data))
        numbers: list[Any] = data.tolist()
        return numbers

    def lists(self, content: Any) -> list[Any]:
        """Returns lists of numbers, all of one length."""
        width, node = content
        flat = self.node(node)
        self._budget.charge(ELEMENT * 2 * (len(flat) // width))
        return [flat[i : i + width] for i in range(0, len(flat), width)]

    def rows(self, content: Any) -> list[dict[Any, Any]]:
        """Returns dicts, all with the same keys."""
        count, keys, columns = content
        names = self.node(keys)
        self._budget.charge((_DICT + ELEMENT * len(names)) * count)
        self._budget.charge_keys(names, count)
        if not names:
            return [{} for _ in range(count)]
        parts = [self.node(column) for column in columns]
        if len(parts) != len(names) or any(len(part) != count for part in parts):
            raise InvalidAnswerError("columns differ in length")
        # The lengths are checked once: checking them in each row takes a third of the time.
        return [dict(zip(names, row)) for row in zip(*parts)]  # noqa: B905

    def dict(self, content: Any) -> dict[Any, Any]:
        """Returns a dict."""
        parts = self.node(content)
        self._budget.charge(_DICT + ELEMENT * len(parts))
        self._budget.charge_keys(parts[::2])
        return dict(zip(parts[::2], parts[1::2], strict=True))

    def row(self, content: Any) -> tuple[Any, ...]:
        """Returns a tuple, or a named one."""
        names, values = content
        parts = self.node(values)
        if not names:
            return tuple(parts)
        if len(names) > _MAX_NAMES:
            raise InvalidAnswerError("a row has too many names")
        self._budget.charge_class(tuple(names))
        row: tuple[Any, ...] = class_of_rows(tuple(names))._make(parts)
        return row

    def array(self, content: Any) -> np.ndarray[Any, Any]:
        """Returns an array."""
        kind, shape, data = content
        if kind == "fields":
            arrays = {name: self.array(part) for name, part in _named(data)}
            depth = len(shape)
            if not arrays or any(list(array.shape[:depth]) != shape for array in arrays.values()):
                raise InvalidAnswerError("the fields of an array differ in length")
            types: Any = [
                (name, array.dtype, array.shape[depth:]) for name, array in arrays.items()
            ]
            self._budget.charge(sum(array.nbytes for array in arrays.values()))
            structured = np.zeros(shape, types)
            for name, array in arrays.items():
                structured[name] = array
            return structured
        if kind == "objects":
            values = self.node(data)
            objects = np.full(len(values), None, object)
            for i, value in enumerate(values):
                objects[i] = value
            return objects.reshape(shape)
        sort, raw = np.dtype(kind), self.part(data)
        if sort.kind not in _KINDS or sort.hasobject or sort.names or sort.shape:
            raise InvalidAnswerError("an array is of no plain type")
        if not sort.itemsize:  # texts without characters
            self._budget.charge(ELEMENT * math.prod(shape))
            return np.zeros(shape, sort)
        return np.frombuffer(raw, sort).reshape(shape)

    def table(self, content: Any) -> pa.Table:
        """Returns a table."""
        return self._table(self.part(content), self._budget)

    def entity(self, content: Any) -> Any:
        """Returns an entity, or a reference to one."""
        world, number, name, kind, tick, full_name = content
        is_right = is_short(number) and (tick is None or is_short(tick))
        if not (is_right and set(map(type, (world, name, kind, full_name))) == {str}):
            raise InvalidAnswerError("this is no entity")
        return self._entity(world, number, name, kind, tick, full_name)

    def entities(self, content: Any) -> list[Any]:
        """Returns a list of entities, of which each is told once."""
        parts, numbers = content
        known = [self.entity(part) for part in parts]
        return [known[number] for number in self.node(numbers)]

    def object(self, content: Any) -> Any:
        """Returns a grid, or what tells why a condition holds."""
        name, parts = content
        made = _OBJECTS[name](**{field: self.node(part) for field, part in _named(parts)})
        match made:
            case Why(
                text=str(),
                value=bool() | None,
                margin=float() | None,
                time=float() | None,
                detail=str(),
                points=tuple() as points,
                move=Move() | None,
                parts=tuple() as below,
            ):
                is_right = all(map(_is_place, points)) and {Why}.issuperset(map(type, below))
            case Move(entity=str(), translation=translation):
                is_right = _is_place(translation)
            case _:
                is_right = isinstance(getattr(made, "cells", None), np.ndarray)
        if not is_right:
            raise InvalidAnswerError(f"this is no {name}")
        return made

    def other(self, content: Any) -> Any:
        """Returns a frame, a graph or a picture."""
        kind, *rest = content
        if kind == "graph":
            return self._graph(*rest)
        if kind == "picture":
            from PIL import Image

            mode, width, height, place = rest
            self._budget.charge(4 * abs(width * height))
            return Image.frombytes(
                mode if mode in _MODES else "L", (width, height), self.part(place)
            )
        dtypes, place = rest
        table = self.table(place)
        if kind == "polars":
            return library("polars", "polars").from_arrow(table)
        self._budget.charge(size_of_values(table))
        return _frame(table, dtypes)

    def _graph(self, name: str, content: Any) -> Any:
        library("networkx", "graph")
        from ssduck.adapters import entity_graphs

        nodes, edges = self.node(content)
        self._budget.charge(_NODE * len(nodes) + _EDGE * len(edges))
        self._budget.charge_keys(part for one in (*nodes, *edges) for part in one[:-1])
        graph = getattr(entity_graphs, name if name in _GRAPHS else _GRAPHS[0])()
        graph.add_nodes_from([(node, attributes) for node, attributes in nodes])
        graph.add_edges_from([tuple(edge) for edge in edges])
        return graph

    def text(self, content: Any) -> str:
        """Returns a long text."""
        data = bytes(self.part(content))
        self._budget.charge_text(data)
        return data.decode("utf-8", "surrogatepass")


def _is_place(value: Any) -> bool:
    """Checks whether a value is x y z."""
    return type(value) is tuple and len(value) == 3 and {float}.issuperset(map(type, value))


def _named(parts: list[Any]) -> list[Any]:
    """Returns pairs of a name and a part."""
    if not all(type(name) is str for name, _ in parts):
        raise InvalidAnswerError("a part has no name")
    return parts


def _frame(table: pa.Table, dtypes: Sequence[str]) -> Any:
    """Returns a frame of pandas: with types that know missing values, and lists as lists."""
    pandas = library("pandas", "pandas")
    nullable = {pa.int64(): pandas.Int64Dtype(), pa.bool_(): pandas.BooleanDtype()}
    frame = table.to_pandas()
    for i, dtype in enumerate(dtypes):
        column = table.column(i)
        if pa.types.is_nested(column.type):
            frame.isetitem(i, pandas.Series(column.to_pylist(), dtype=object))
        elif dtype in ("Int64", "boolean"):
            frame.isetitem(i, column.to_pandas(types_mapper=nullable.get))
    return frame


_DECODERS: dict[str, Callable[[Decoder, Any], Any]] = {
    "int": Decoder.integer,
    "text": Decoder.text,
    "bytes": lambda self, content: bytes(self.part(content)),
    "numbers": Decoder.numbers,
    "lists": Decoder.lists,
    "rows": Decoder.rows,
    "dict": Decoder.dict,
    "tuple": Decoder.row,
    "list": lambda self, content: self.node(content),
    "array": Decoder.array,
    "scalar": lambda self, content: self.array(content)[()],
    "table": Decoder.table,
    "result": lambda self, content: Result(self.table(content)),
    "entity": Decoder.entity,
    "entities": Decoder.entities,
    "world": lambda self, content: self._world(str(content)),
    "object": Decoder.object,
    "other": Decoder.other,
    "datetime": lambda _, content: dt.datetime.fromisoformat(content),
    "date": lambda _, content: dt.date.fromisoformat(content),
    "time": lambda _, content: dt.time.fromisoformat(content),
    "duration": lambda _, content: dt.timedelta(content[0], content[1], content[2]),
    "decimal": lambda _, content: Decimal(content),
    "uuid": lambda _, content: UUID(content),
}
