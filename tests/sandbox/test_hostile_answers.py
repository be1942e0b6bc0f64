"""What a worker that was taken over sends is data, of a bounded size, or an error."""

import gc
import json
import resource
import sys
import time

import numpy as np
import pyarrow as pa
import pytest

from ssduck.errors import LimitError, SandboxError
from ssduck.limits import ANSWER_BYTES, Limits
from ssduck.sandbox import EntityReference, SandboxedInterpreter
from ssduck.sandbox.budget import Budget, InvalidAnswerError
from ssduck.sandbox.tables import checked_table, table_bytes
from ssduck.sandbox.values import Decoder, Encoder

SEND = """
import os, struct
def send(document, body=b"", *, mark=b"duck", number=None, length=None, size=None):
    import gc
    from ssduck.sandbox.messages import Message
    asked = [one for one in gc.get_objects() if isinstance(one, Message)][-1].number
    head = struct.pack("<4sIQQ", mark, asked if number is None else number,
        len(document) if length is None else length, len(body) if size is None else size)
    os.write(connection, head + document + body)
{}
"""
# What is sent in place of an answer.
SENT = {
    "another mark": "send(b'[1, []]', mark=b'duke')",
    "another question": "send(b'[1, []]', number=99)",
    "no JSON": "send(b'[1, [')",
    "no text": "send(bytes(range(128, 200)))",
    "nothing": "send(b'')",
    "a number": "send(b'1')",
    "no list of warnings": "send(b'[1, 2]')",
    "an unknown tag": 'send(b\'[{{"pickle": "x"}}, []]\')',
    "two tags": 'send(b\'[{{"int": "1", "text": [0, 0]}}, []]\')',
    "a part outside": "send(b'[{{\"text\": [0, 9]}}, []]', b'abc')",
    "a part before": "send(b'[{{\"text\": [-9, 9]}}, []]', b'abc')",
    "brackets": "send(b'[' * 50000)",
    "many empty lists": "send(b'[' + b'[],' * 5000000 + b'[]]')",
    "a huge body": "send(b'[1, []]', size=1 << 40)",
    "a huge document": "send(b'[1, []]', length=1 << 62)",
    "a wrong error": 'send(b\'[null, [], {{"dict": ["class", "SqlError", "message", 5]}}]\')',
    "a class of errors": "send(b'[null, [], [1]]')",
    "an end": "os._exit(0)",
    "a crash": "import ctypes; ctypes.string_at(0)",
    "half": "os.write(connection, b'duck' + b'x' * 5); os._exit(0)",
}


@pytest.mark.slow
@pytest.mark.parametrize("name", SENT)
def test_what_is_no_answer_ends_the_process(zygote, name):
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    with SandboxedInterpreter(zygote=zygote) as ss:
        ss["mine"] = 1
        with pytest.raises(LimitError, match="process of the program"):
            ss.ask("worker.python", SEND.format(SENT[name].replace("{{", "{").replace("}}", "}")))
        assert ss.eval("mine;") == 1
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 50_000


@pytest.mark.slow
def test_an_error_of_another_class_is_plain(zygote):
    told = 'send(b\'[null, [], {"dict": ["class", "SystemExit", "message", "x"]}]\')'
    with SandboxedInterpreter(zygote=zygote) as ss, pytest.raises(SandboxError, match=r"x$"):
        ss.ask("worker.python", SEND.replace("{}", f"{told}\nimport time\ntime.sleep(0.5)"))


@pytest.mark.slow
def test_answers_as_large_as_allowed_and_larger(zygote):
    with SandboxedInterpreter(zygote=zygote, limits=Limits.strict(answer_bytes=2_000_000)) as ss:
        assert len(ss.eval("'abcdefghij' * 90000;")) == 900_000
        for program in ("'abcdefghij' * 300000;", "[1.5] * 100000;", "['ab'] * 100000;"):
            with pytest.raises(LimitError, match="answer_bytes"):
                ss.eval(program)
        with pytest.raises(LimitError, match="answer_bytes"):
            ss.sql("SELECT range, range FROM range(300000)")
        assert ss.eval("1;") == 1  # by the same process


# -- tables -----------------------------------------------------------------------------------


def stream(table, **options):
    sink = pa.BufferOutputStream()
    with pa.ipc.new_stream(sink, table.schema, options=pa.ipc.IpcWriteOptions(**options)) as out:
        out.write_table(table)
    return memoryview(bytearray(sink.getvalue()))


NUMBERS = pa.table({"a": pa.array(range(1000))})
BYTES = pa.array([b"x" * 16], pa.binary(16))
TYPES, PLACES = pa.array([0], pa.int8()), pa.array([0], pa.int32())
NO_TEXT = [None, pa.py_buffer(b"\0\0\0\0\2\0\0\0"), pa.py_buffer(b"\xff\xff")]
# Columns of tables that no worker sends, and what is no table that one sends.
FORGED = {
    "a dictionary": lambda: pa.array(["x"] * 9).dictionary_encode(),
    "repetitions": lambda: pa.RunEndEncodedArray.from_arrays(pa.array([2**30], pa.int32()), [1]),
    "views": lambda: pa.array(["x" * 99], pa.string_view()),
    "views of lists": lambda: pa.array([[1]], pa.list_view(pa.int8())),
    "an extension": lambda: pa.ExtensionArray.from_storage(pa.uuid(), BYTES),
    "an extension inside": lambda: pa.array([[b"x" * 16]], pa.list_(BYTES.type)).cast(
        pa.list_(pa.uuid())
    ),
    "a union": lambda: pa.UnionArray.from_dense(TYPES, PLACES, [pa.array([1])]),
    "texts that are none": lambda: pa.Array.from_buffers(pa.string(), 1, NO_TEXT),
    "compressed": lambda: stream(NUMBERS, compression="zstd"),
    "compressed otherwise": lambda: stream(NUMBERS, compression="lz4"),
    "no stream": lambda: memoryview(b"x" * 100),
    "nothing": lambda: memoryview(b""),
    "a half": lambda: stream(NUMBERS)[:-600],
}


@pytest.mark.parametrize("name", FORGED)
def test_forged_tables_are_refused(name):
    data = FORGED[name]()
    if not isinstance(data, memoryview):
        data = stream(pa.table({"a": data}))
    with pytest.raises(InvalidAnswerError):
        checked_table(data, Budget())


def test_tables_of_many_rows_without_bytes_are_counted():
    many = 2**24
    nothing = pa.nulls(many)
    for column in (
        nothing,
        pa.FixedSizeListArray.from_arrays(nothing, many),
        pa.ListArray.from_arrays([0, many], nothing),
        pa.Array.from_buffers(pa.binary(0), many, [None, pa.py_buffer(b"")]),
        pa.Array.from_buffers(pa.struct([]), many, [None]),
    ):
        with pytest.raises(LimitError, match="answer takes"):
            checked_table(stream(pa.table({"a": column})), Budget())


@pytest.mark.parametrize("seed", range(40))
def test_damaged_tables_are_refused_or_are_tables(seed):
    """Flipped bytes of a stream never make more of it than a table, or an error."""
    generator = np.random.default_rng(seed)
    table = pa.table(
        {"a": range(50), "s": ["text"] * 50, "l": [[1, 2], None] * 25, "d": [{"x": 1.5}] * 50}
    )
    for _ in range(50):
        data = bytearray(table_bytes(table))
        for place in generator.integers(0, len(data), 3):
            data[place] ^= 1 << generator.integers(0, 8)
        try:
            found = checked_table(memoryview(data), Budget())
        except (InvalidAnswerError, LimitError):
            continue
        assert found.to_pylist() is not None


# -- JSON and arrays --------------------------------------------------------------------------


def decoded(document, body=b"", size=ANSWER_BYTES):
    decoder = Decoder(memoryview(bytearray(body)), Budget(size), world=str)
    return decoder.value(json.dumps(document).encode())


WRONG = [
    {"array": ["O", [1], [0, 8]]},
    {"array": ["V8", [1], [0, 8]]},
    {"array": ["<f8", [2], [0, 8]]},
    {"array": ["<f8", [-1, -1], [0, 8]]},
    {"array": ["<f8,<f8", [1], [0, 16]]},
    {"array": ["fields", [2], [["a", ["<f8", [1], [0, 8]]]]]},
    {"array": [5, [1], [0, 8]]},
    {"numbers": ["O", [0, 8]]},
    {"numbers": ["<f8", [0, 7]]},
    {"lists": [0, [1]]},
    {"lists": [-1, [1]]},
    {"rows": [-(10**9), [], []]},
    {"rows": [float("nan"), [], []]},
    [{"bytes": [0, 16]}, {"bytes": [0, 16]}],
    {"array": ["fields", [10**9], []]},
    {"array": ["fields", [2], [[1, ["<f8", [2], [0, 16]]]]]},
    {"object": ["OccupancyGrid", [[1, 2]]]},
    {"rows": [3, ["a"], [[1, 2]]]},
    {"rows": [2, ["a", "b"], [[1, 2], [1]]]},
    {"dict": [[1], 2]},
    {"dict": [1]},
    {"tuple": [["a b"], []]},
    {"tuple": [["a"], [1, 2]]},
    {"entity": ["kitchen", "1", "x", "robot", None, "x"]},
    {"entity": [["kitchen"], 1, "x", "robot", None, "x"]},
    {"entities": [[["kitchen", 1, "x", "robot", None, "x"]], [0, 1]]},
    {"entities": [[{"list": []}], [0]]},
    {"entities": [[["kitchen", 1, "x", "robot", None, "x"]], ["x"]]},
    {"entities": ["x", [0]]},
    {"entity": ["kitchen", 2**63, "x", "robot", None, "x"]},
    {"object": ["os", []]},
    {"object": ["OccupancyGrid", [["cells", 1]]]},
    {"object": ["OccupancyGrid", [["cells", {"array": ["<f8", [1], [0, 8]]}], ["x", 1]]]},
    {"object": ["Why", [["text", "a"]]]},
    {"object": ["Why", [["text", "a"], ["value", 1]]]},
    {"object": ["Why", [["text", "a"], ["value", True], ["points", {"tuple": [[], [1.0]]}]]]},
    {"object": ["Why", [["text", "a"], ["value", True], ["parts", {"tuple": [[], ["a"]]}]]]},
    {"object": ["Move", [["entity", "cup"], ["translation", [0.0, 0.0, 1.0]]]]},
    {"other": ["picture", "RGB", 9, 9, [0, 8]]},
    {"other": ["pandas", [], [0, 8]]},
    {"int": "x"},
    {"decimal": "x"},
    {"datetime": "x"},
    {"uuid": "x"},
    {"text": [0]},
    {},
    {"__class__": 1},
]


# The hash of a multiple of this number is 0.
ALIKE = sys.hash_info.modulus


@pytest.mark.parametrize("document", [b"1" * 1_000_000, b'{"int":"-0x%b"}' % (b"f" * 250_001)])
def test_integers_of_many_digits_do_not_hold_the_host_up(document):
    """The command line, which shows long integers, has no limit of digits."""
    before, begin = sys.get_int_max_str_digits(), time.process_time()
    sys.set_int_max_str_digits(0)
    try:
        with pytest.raises(InvalidAnswerError, match="an integer"):
            Decoder(memoryview(b""), Budget(), world=str).value(document)
    finally:
        sys.set_int_max_str_digits(before)
    assert time.process_time() - begin < 1  # 13 s where all digits are read


def test_the_largest_integers_of_the_language_cross(empty):
    assert empty.eval("2^499999 * 2^499999;") == 2**999_998
    assert empty.eval("-(2^499999 * 2^499999);") == -(2**999_998)


@pytest.mark.parametrize("document", WRONG, ids=json.dumps)
def test_wrong_values_are_refused(document):
    with pytest.raises(InvalidAnswerError):
        decoded(document, bytes(16))


@pytest.mark.parametrize(
    "document",
    [
        {"rows": [10**9, [], []]},
        {"array": ["<U0", [10**12], [0, 0]]},
        {"other": ["picture", "RGB", 10**6, 10**6, [0, 0]]},
        # Dicts of keys that all have the same hash, which Python compares one by one.
        {"dict": [part for i in range(20_000) for part in ({"int": hex(i * ALIKE)}, 0)]},
        {"rows": [100, [i * ALIKE for i in range(2000)], [[0] * 100] * 2000]},
        # Classes of rows.
        [{"tuple": [[f"name{i}"], [0]]} for i in range(20_000)],
    ],
    ids=lambda document: str(document)[:40],
)
def test_values_without_bytes_are_counted(document):
    gc.collect()
    with pytest.raises((LimitError, InvalidAnswerError)):
        decoded(document)


@pytest.mark.parametrize("kind", ["nodes", "edges"])
def test_graphs_whose_keys_are_alike_are_counted(kind):
    """They take seconds of the host, which compares each with the others."""
    alike = [{"int": hex(i * ALIKE)} for i in range(10_000)]
    nodes = [{"list": [key, {"dict": []}]} for key in alike] if kind == "nodes" else []
    edges = [{"list": ["a", "b", key, {"dict": []}]} for key in alike] if kind == "edges" else []
    document = {"other": ["graph", "EntityMultiGraph", [{"list": nodes}, {"list": edges}]]}
    with pytest.raises(LimitError, match="answer takes"):
        decoded(document)


@pytest.mark.parametrize("column", [["x" * 9_000_000 + "\U0001f986"], [{"a": None}] * 100_000])
def test_frames_are_counted_as_what_python_makes_of_them(column):
    data = bytes(table_bytes(pa.table({"a": column})))
    with pytest.raises(LimitError, match="answer takes"):
        decoded({"other": ["pandas", ["object"], [0, len(data)]]}, data)


@pytest.mark.parametrize("seed", range(20))
def test_damaged_answers_are_refused_or_are_values(seed):
    """Changed signs of an answer never raise anything but that it is none, or is too large."""
    generator = np.random.default_rng(seed)
    encoder = Encoder(Budget(), str)
    rows = [{"a": i, "b": "text", "c": [1.5, 2.5]} for i in range(20)]
    arrays = [np.arange(6.0).reshape(2, 3), np.array([("a", 1)], "U1,i4"), np.array([None, "x"])]
    plain = ["x" * 2000, 2**80, (1, "a"), {"k": [True, None]}, b"bytes", pa.table({"a": [1, 2]})]
    text = encoder.text([rows, arrays, plain, EntityReference("kitchen", 1, "x", "robot")])
    body = bytearray(b"".join(encoder.parts))
    signs = b'[]{}",:0123456789-.eE\\u<>|fiUSOMV'
    for _ in range(200):
        changed = bytearray(text)
        for place in generator.integers(0, len(text), generator.integers(1, 4)):
            changed[place] = signs[generator.integers(0, len(signs))]
        decoder = Decoder(memoryview(bytearray(body)), Budget(4_000_000), world=str)
        try:
            assert decoder.value(bytes(changed)) is not ...
        except (InvalidAnswerError, LimitError):
            continue
