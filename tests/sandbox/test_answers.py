"""Answers of a sandbox equal those of an interpreter in this process."""

import datetime as dt
import pickle
from decimal import Decimal

import numpy as np
import pandas as pd
import polars as pl
import pyarrow as pa
import pytest

import ssduck
from ssduck.adapters.display import as_json
from ssduck.errors import (
    ArgumentError,
    FunctionError,
    LimitError,
    ProgramWarning,
    SandboxError,
    SqlError,
    UnknownNameError,
    UnsupportedError,
)
from ssduck.sandbox import EntityReference, SandboxedInterpreter, opening
from ssduck.sandbox.budget import Budget
from ssduck.sandbox.reports import error_of, told_error
from ssduck.sandbox.sources import Source
from ssduck.sandbox.values import Decoder, Encoder


@pytest.fixture(scope="module")
def sandbox(zygote):
    with opening.load("kitchen", zygote=zygote) as ss:
        yield ss


@pytest.fixture(scope="module")
def here():
    with ssduck.load("kitchen") as ss:
        yield ss


PROGRAMS = [
    "1 + 1;",
    "2 ^ 70;",
    "'text' + \"ü\\u0000\";",
    "1 / 3;",
    "True;",
    "[1, 2.5, 'a', [True, []]];",
    "SELECT id, z FROM kitchen;",
    "SELECT id, position, mass FROM kitchen WHERE isRobot(this);",
    "SELECT id, z FROM kitchen WHERE z > 100;",
    "SELECT id, position FROM kitchen AS list;",
    "SELECT type, count(*) AS n FROM kitchen GROUP BY type;",
    "SELECT z FROM kitchen WHERE id == 'fridge' AS value;",
    "SELECT id, z FROM kitchen AS json;",
    "SELECT id, z FROM kitchen AS csv;",
    "SELECT id, z FROM kitchen AS records;",
    "SELECT above(kitchen.table, this) FROM kitchen AS prolog;",
    "SELECT time(this), id FROM kitchen{} AS list;",
]


@pytest.mark.parametrize("program", PROGRAMS)
def test_values_are_the_same(sandbox, here, program):
    assert sandbox.eval(program) == here.eval(program)
    assert repr(sandbox.eval(program)) == repr(here.eval(program))


@pytest.mark.slow
def test_tables_are_the_same(sandbox, here):
    query = "SELECT id, z, kind, position, isRobot(this) AS robot FROM kitchen AS {};"
    frame, own = (ss.eval(query.format("df")) for ss in (sandbox, here))
    pd.testing.assert_frame_equal(frame, own)
    assert type(frame["position"][0]) is type(own["position"][0])
    assert sandbox.eval(query.format("arrow")).equals(here.eval(query.format("arrow")))
    frame = sandbox.eval(query.format("polars"))
    assert frame.equals(here.eval(query.format("polars")))
    table, own = (ss.eval(query.format("table")) for ss in (sandbox, here))
    assert (table.fetchall(), table.columns, table.types) == (
        own.fetchall(),
        own.columns,
        own.types,
    )


def test_arrays_are_the_same(sandbox, here):
    for columns in ("position", "id, z", "z, isRobot(this)"):
        query = f"SELECT {columns} FROM kitchen AS numpy;"
        found, own = sandbox.eval(query), here.eval(query)
        assert found.dtype == own.dtype
        np.testing.assert_array_equal(found, own)
        found[0] = found[1]  # it can be changed, as in this process


@pytest.mark.slow
def test_grids_and_pictures_are_the_same(sandbox, here):
    for form in ("occupancygrid(0.1, 0.1)", "voxelgrid(0.2)", "sensorgrid(0.2, 0.2)"):
        query = f"SELECT obj FROM kitchen WHERE NOT isPlane(this) AS {form};"
        found, own = sandbox.eval(query), here.eval(query)
        assert type(found) is type(own)
        np.testing.assert_array_equal(found.cells, own.cells)
        assert (found.origin, found.resolution) == (own.origin, own.resolution)
    picture = sandbox.eval("SELECT obj FROM kitchen AS image;")
    assert picture.tobytes() == here.eval("SELECT obj FROM kitchen AS image;").tobytes()


STATEMENTS = [
    "SELECT name, kind, x, y, z FROM entities ORDER BY name",
    "SELECT a.name, b.name FROM entities a, entities b WHERE above(a, b) ORDER BY ALL",
    "SELECT tick, id, name, mass, x FROM links ORDER BY id LIMIT 5",
    "SELECT 1::HUGEINT AS a, 2::UTINYINT AS b, 0.5::FLOAT AS c, 1.25::DECIMAL(10, 3) AS d",
    "SELECT DATE '2020-02-29' AS a, TIME '12:34:56' AS b, TIMESTAMP '2020-01-01 00:00:00' AS c",
    "SELECT INTERVAL 3 DAY AS a, 'x'::BLOB AS b, uuid() IS NULL AS c, NULL AS d",
    "SELECT [1, 2] AS a, {'x': 1, 'y': [{'z': 2.0}]} AS b, MAP {'k': 1} AS c, [1.0, 2.0]::DOUBLE[2]",
    "SELECT 'happy'::ENUM ('happy', 'sad') AS mood, 'nan'::DOUBLE AS n, 'inf'::DOUBLE AS i",
    "SELECT name FROM entities WHERE false",
    "SELECT range AS i, range * 0.5 AS x, 'name' || range AS s FROM range(20000)",
    "SELECT count(*) FROM entities_history",
]


@pytest.mark.parametrize("statement", STATEMENTS)
def test_sql_is_the_same(sandbox, here, statement):
    found, own = sandbox.sql(statement), here.sql(statement)
    assert found.columns == own.columns
    assert repr(found.fetchall()) == repr(own.fetchall())


def test_parameters_cross(sandbox):
    assert sandbox.sql("SELECT ? + 1, ?", [41, "x"]).fetchall() == [(42, "x")]
    assert sandbox.sql("SELECT $a AS a", {"a": 1.5}).fetchall() == [(1.5,)]
    assert sandbox.eval("SELECT this FROM [1, 2] WHERE this > low AS list;", {"low": 1}) == [2]


@pytest.mark.slow
def test_programs_are_compiled_explained_and_shown(sandbox, here):
    text = "SELECT id, z FROM kitchen WHERE z > 1;"
    program = sandbox.compile(text)
    assert sandbox.eval(program) == here.eval(text)
    assert program.sql() == here.compile(text).sql()
    assert sandbox.explain(program) == here.explain(text)
    assert str(sandbox.show(program)) == str(here.show(text))
    assert sandbox.help("above") == here.help("above")
    assert sandbox.help() == here.help()


# -- errors and warnings ----------------------------------------------------------------------

FAILURES = [
    ("eval", "SELECT FROM;"),
    ("eval", "SELECT this FROM kitchn;"),
    ("eval", "kitchen.frigde;"),
    ("eval", "1 / 0;"),
    ("eval", "[1][5];"),
    ("eval", "near(1);"),
    ("sql", "SELECT * FROM entitys"),
    ("sql", "SELECT nme FROM entities"),
    ("sql", "SELEC"),
    ("compile", "1 +;"),
    ("help", "abov"),
]


@pytest.mark.parametrize(("method", "text"), FAILURES)
def test_errors_cross(sandbox, here, method, text):
    told = []
    for ss in (sandbox, here):
        with pytest.raises(ssduck.SelectScriptError) as caught:
            getattr(ss, method)(text)
        told.append(caught.value)
    found, own = told
    assert type(found) is type(own)
    assert str(found) == str(own)
    assert (found.line, found.column, found.suggestions) == (own.line, own.column, own.suggestions)


def test_errors_that_are_none_of_ssducks_are_plain(sandbox):
    with pytest.raises(SandboxError, match="ZeroDivisionError"):
        sandbox.ask("worker.python", "1 / 0")


def test_warnings_cross(sandbox):
    with pytest.warns(ProgramWarning, match="fridg") as caught:
        sandbox.sql("SELECT * FROM entities WHERE name = 'fridg'")
    assert caught[0].filename == __file__


def test_what_programs_print_is_printed_here(sandbox, capsys):
    assert sandbox.eval("print('one', 2);") == 2
    assert sandbox.eval("3;") == 3
    assert capsys.readouterr().out == "one 2\n"
    sandbox.eval("print('red \\u001b[31m');")
    assert capsys.readouterr().out == "red \\u001b[31m\n"


@pytest.mark.slow
def test_a_strict_sandbox_makes_mistakes_errors(zygote):
    with SandboxedInterpreter(Source.of_scene("kitchen"), strict=True, zygote=zygote) as ss:
        with pytest.raises(UnknownNameError, match="fridge"):
            ss.sql("SELECT * FROM entities WHERE name = 'fridg'")
        ss.strict = False
        with pytest.warns(ProgramWarning):
            ss.sql("SELECT * FROM entities WHERE name = 'fridg'")


# -- variables, worlds, records ---------------------------------------------------------------

VALUES = [
    *(None, True, 0, -(2**63), 2**64, 1.5, float("inf"), "x", "x" * 5000, "\ud800", b"\0bytes"),
    *([], [1, [2, {"a": [3]}]], {"a": 1, 2: "b"}, list(range(100)), [[0.0, 1.0]] * 20),
    *([{"a": 1, "b": None}] * 20, [1, 2.5] * 20, [2**70] * 20, [{"a": 1}, {"b": 2}] * 10),
    *(dt.datetime(2020, 1, 2, 3, 4, 5, tzinfo=dt.UTC), dt.date(2020, 1, 2), Decimal("1.50")),
    *(dt.timedelta(1, 2, 3), (1, "a"), [{}] * 20, [[]] * 20, [True, False] * 10),
    {number: number for number in range(-20_000, 20_000)},
]


def crossed(value):
    """What is left of a value that is written in one process and read in another."""
    encoder = Encoder(Budget(), str)
    text = encoder.text(value)
    body = memoryview(bytearray(b"".join(encoder.parts)))
    return Decoder(body, Budget(), world=str).value(text)


@pytest.mark.parametrize("value", VALUES, ids=lambda value: repr(value)[:30])
def test_values_cross(value):
    found = crossed(value)
    assert found == value
    assert type(found) is type(value)
    assert repr(found) == repr(value)


@pytest.mark.parametrize(
    "array",
    [
        np.arange(6.0).reshape(2, 3),
        np.array([], np.int32),
        np.array([True, False]),
        np.array(["a", "bcd"]),
        np.array(["", ""]),
        np.array(["2020-01-01"], "datetime64[D]"),
        np.array([("a", 1.5, [1, 2])], [("s", "U3"), ("x", "f4"), ("v", "i4", (2,))]),
        np.array([1, "a", None, [1]], object),
        np.float32(1.5),
        np.zeros((3, 0)),
    ],
    ids=repr,
)
def test_arrays_cross(array):
    found = crossed(array)
    assert (found.dtype, found.shape, type(found)) == (array.dtype, array.shape, type(array))
    assert np.array_equal(found, array)


@pytest.mark.slow
def test_variables_are_the_hosts_and_outlive_the_process(zygote):
    with opening.load("kitchen", zygote=zygote) as ss:
        ss["high"] = 1.2
        ss.add_variable("points", np.eye(3))
        ss.eval("low = 0.5;")
        assert (ss["high"], ss["low"], "low" in ss, "none" in ss) == (1.2, 0.5, True, False)
        assert {"kitchen", "high", "points", "low"} == set(ss)
        with pytest.raises(LimitError, match="variables that programs have set are gone"):
            ss.ask("worker.python", "__import__('os')._exit(3)")
        assert ss.eval("high;") == 1.2
        np.testing.assert_array_equal(ss["points"], np.eye(3))
        with pytest.raises(UnknownNameError):
            ss.eval("low;")


def test_entities_are_references_that_go_back(sandbox):
    fridge = sandbox.eval("kitchen.fridge;")
    assert fridge == EntityReference("kitchen", fridge.id, "fridge", "robot")
    sandbox["it"] = fridge
    assert sandbox.eval("it == kitchen.fridge;") is True
    assert sandbox.eval("SELECT id(it) FROM [1] AS value;") == "fridge"
    with pytest.raises(UnsupportedError, match="in the sandbox"):
        fridge.move([0, 0, 0])
    rows = sandbox.eval("SELECT this FROM kitchen AS list;")
    assert len(rows) == 37
    assert all(isinstance(row, EntityReference) for row in rows)


@pytest.mark.parametrize(
    "program",
    [
        "SELECT a, b FROM a=kitchen, b=kitchen WHERE distance(a, b) < 1 AS {};",
        "SELECT a, b FROM a=links(kitchen), b=kitchen WHERE b == kitchen.fridge AS {};",
        "SELECT a, b FROM a=kitchen{{0.0}}, b=kitchen{{0.05}} WHERE isRobot(a) AS {};",
    ],
)
def test_entities_of_many_rows_are_those_of_the_rows(zygote, program):
    with opening.load("kitchen", zygote=zygote) as ss, ssduck.load("kitchen") as here:
        for one in (ss, here):
            one.run(0.1)
        for form in ("list", "dict"):
            found, own = (one.eval(program.format(form)) for one in (ss, here))
            flat, expected = (
                [value for row in rows for value in (row.values() if form == "dict" else [row])]
                for rows in (found, own)
            )
            assert len(flat) > len(set(flat)) > 30
            assert [(one.id, one.full_name, one.kind, one.tick) for one in flat] == [
                (one.id, one.full_name, one.kind, one.moment and one.moment.tick)
                for one in expected
            ]


@pytest.mark.slow
@pytest.mark.parametrize("source", ["kitchen", "links(kitchen)", "kitchen{0}"])
def test_entities_are_shown_by_their_names(sandbox, here, source):
    shown, own = (ss.show(f"SELECT this, z FROM {source};") for ss in (sandbox, here))
    assert (repr(shown), shown._repr_html_()) == (repr(own), own._repr_html_())
    assert as_json(sandbox["kitchen"]) == as_json(here["kitchen"])


def test_worlds_are_stepped_in_the_sandbox(zygote, here):
    with opening.load("kitchen", zygote=zygote) as ss:
        kitchen = ss["kitchen"]
        assert [world.name for world in ss.worlds] == ["kitchen"]
        assert (kitchen.time, len(kitchen)) == (0.0, 37)
        kitchen.step(24)
        assert kitchen.time == pytest.approx(24 * kitchen.timestep)
        ss.run(0.1)
        kitchen.run(0.1)
        assert ss.eval("getTime();") == kitchen.time == pytest.approx(0.3)
        tables = {name: kitchen.table(name) for name in ("entities", "links", "joints", "contacts")}
        assert tables["entities"].num_rows == 37
        assert set(tables["links"]["time"].to_pylist()) == {kitchen.time}
        with pytest.raises(UnknownNameError, match="did you mean 'entities'"):
            kitchen.table("entitys")
        number = kitchen.tick_number
        assert kitchen.tick().tick_number == number + 1
        assert ss.sql("SELECT count(DISTINCT tick) FROM entities_history").fetchone()[0] > 50


@pytest.mark.slow
def test_what_cannot_be_opened_is_the_same_error(zygote, tmp_path):
    (tmp_path / "broken.urdf").write_text("<robot")
    for scene in ("kitchn", tmp_path / "none.urdf", tmp_path / "broken.urdf"):
        told = []
        for load in (lambda s: opening.load(s, zygote=zygote), ssduck.load):
            with pytest.raises(ssduck.SelectScriptError) as caught:
                load(scene)
            told.append((type(caught.value), str(caught.value)))
        assert told[0] == told[1]
    with pytest.raises(ssduck.errors.RecordError):
        opening.open_record(tmp_path / "none", zygote=zygote)


@pytest.mark.slow
def test_a_variable_that_cannot_be_set_again_is_told(zygote):
    with opening.load("kitchen", zygote=zygote) as ss:
        ss.eval("piece = (SELECT obj FROM kitchen WHERE id == 'fridge' AS environment);")
        ss["it"] = ss.eval("SELECT this FROM piece AS list;")[0]
        ss["high"] = 1.5
        with pytest.raises(LimitError):
            ss.ask("worker.python", "__import__('os')._exit(0)")
        with pytest.warns(UserWarning, match="'it' cannot be set again"):
            assert ss["high"] == 1.5


@pytest.mark.slow
def test_a_world_that_a_program_makes_is_a_handle(sandbox):
    part = sandbox.eval("SELECT obj FROM kitchen WHERE id == 'cup_905a' AS environment;")
    assert [entity.name for entity in part] == ["cup_905a"]
    before = part["cup_905a"].position[2]
    part.run(0.25)
    assert part["cup_905a"].position[2] < before
    sandbox["small"] = part
    assert sandbox.eval("z(small.cup_905a);") == part["cup_905a"].position[2]


@pytest.mark.slow
@pytest.mark.parametrize("multi", ["", "(multi=True)"])
def test_graphs_cross(sandbox, here, multi):
    pytest.importorskip("networkx", reason="the extra graph is not installed")
    query = (
        f"SELECT a.this, b.this FROM a=kitchen, b=kitchen WHERE on(a.this, b.this) AS graph{multi};"
    )
    found, own = sandbox.eval(query), here.eval(query)
    assert type(found) is type(own)
    assert dict(found.nodes(data=True)) == dict(own.nodes(data=True))
    assert list(found.edges(data=True)) == list(own.edges(data=True)) != []


@pytest.mark.slow
def test_an_entity_of_the_past_goes_back(zygote):
    with opening.load("kitchen", zygote=zygote) as ss:
        ss["kitchen"].run(0.05)
        (cup,) = ss.eval("SELECT this FROM kitchen{0.0} WHERE id == 'cup_905a' AS list;")
        ss["then"] = cup
        assert cup.tick == 1
        assert ss.eval("z(then);") == ss.eval("z(kitchen{0.0}.cup_905a);")


@pytest.mark.parametrize(
    "text",
    [
        "z(kitchen.can) > 9 AND near(kitchen.table, kitchen.can, 0.1);",
        "kitchen.can IN (SELECT this FROM kitchen WHERE z > 0.5);",
        "a = 2; historically(a > 1 AND NOT isRobot(kitchen.can));",
    ],
)
def test_why_is_the_tree_that_an_interpreter_returns(text, sandbox, here):
    assert sandbox.why(text) == sandbox.why(sandbox.compile(text)) == here.why(text)
    assert sandbox.eval(f"WHY {text}") == str(here.why(text))


def test_why_refuses_what_an_interpreter_does(sandbox):
    with pytest.raises(ArgumentError, match="WHY takes a condition") as caught:
        sandbox.why("SELECT id FROM kitchen;")
    assert caught.value.span is not None


def test_what_a_sandbox_has_not_says_why(sandbox, here):
    world, entity = sandbox["kitchen"], sandbox["kitchen"]["fridge"]
    for name in dir(here):
        if not (name.startswith("_") or hasattr(type(sandbox), name)):
            with pytest.raises(UnsupportedError, match=f"^{name}: "):
                getattr(sandbox, name)
    for name in dir(here["kitchen"]):
        if not (name.startswith("_") or name in ("name", *dir(type(world)))):
            with pytest.raises(AttributeError, match=f"^{name}: .*'kitchen'"):
                getattr(world, name)
    with pytest.raises(UnsupportedError, match="did you mean 'position'"):
        entity.positon  # noqa: B018
    assert not any(hasattr(one, "positon") for one in (entity, world, sandbox))
    copied = pickle.loads(pickle.dumps(entity))  # noqa: S301
    assert copied == entity
    with pytest.raises(UnsupportedError, match="sandbox"):
        copied.position  # noqa: B018
    with pytest.raises(UnsupportedError, match="world of this process"):
        sandbox.eval("z(it);", {"it": here["kitchen"]["fridge"]})
    with pytest.raises(AttributeError):
        sandbox.nothing  # noqa: B018


def test_what_has_no_type_that_crosses_says_so(sandbox):
    with pytest.raises(UnsupportedError, match=r"type sparse_union.*CAST"):
        sandbox.sql("SELECT union_value(k := 1)")


def test_a_closed_one_says_so(zygote):
    ss = SandboxedInterpreter(zygote=zygote)
    ss.close()
    with pytest.raises(LimitError, match="closed"):
        ss.eval("1;")


@pytest.mark.slow
def test_range_joins_are_planned_in_the_sandbox(zygote):
    """SQL with a SEMI JOIN changes a setting for a statement, though settings are locked."""
    query = (
        "SELECT count(*) FROM entities a SEMI JOIN entities b ON a.x < b.x AND a.y > b.y AND "
        "a.z < b.z"
    )
    with opening.load("kitchen", zygote=zygote) as ss, ssduck.load("kitchen") as own:
        for _ in range(2):
            assert ss.sql(query).fetchall() == own.sql(query).fetchall()
        with pytest.raises(SqlError, match="locked"):
            ss.sql("SET memory_limit = '1GB'")


def test_empty_tables_cross(sandbox):
    assert (
        sandbox.sql("SELECT 1 AS a WHERE false")
        .arrow()
        .equals(pa.table({"a": pa.array([], pa.int32())}))
    )
    assert sandbox.eval("SELECT id FROM kitchen WHERE z > 99 AS polars;").equals(
        pl.DataFrame({"id": []})
    )


@pytest.mark.slow
def test_scenes_with_meshes_of_both_simulators_are_loaded(zygote, tmp_path):
    (tmp_path / "part.obj").write_text(
        "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n"
    )
    (tmp_path / "part.urdf").write_text(
        '<robot name="part"><link name="base"><collision><geometry><mesh filename="part.obj"/>'
        "</geometry></collision></link></robot>"
    )
    (tmp_path / "part.xml").write_text(
        '<mujoco><asset><mesh name="part" file="part.obj"/></asset><worldbody><body name="part">'
        '<freejoint/><geom type="mesh" mesh="part"/></body></worldbody></mujoco>'
    )
    for name, simulator in (("part.urdf", None), ("part.xml", "mujoco"), ("part.xml", "pybullet")):
        path = tmp_path / name
        with (
            opening.load(path, simulator=simulator, zygote=zygote) as ss,
            ssduck.load(path, simulator=simulator) as own,
        ):
            for found in (ss, own):
                found["part"].step(5)
            query = "SELECT id, position, mass FROM part;"
            assert ss.eval(query) == own.eval(query)
            ss.eval("piece = (SELECT obj FROM part AS environment);")
            assert len(ss["piece"]) == len(own["part"])


def test_a_scene_that_is_a_link_out_of_its_folder_is_not_opened(tmp_path, zygote):
    (tmp_path / "secret").write_text("a = 'secret'\n")
    (tmp_path / "scene").mkdir()
    scene = tmp_path / "scene" / "scene.toml"
    scene.symlink_to(tmp_path / "secret")
    for path in (scene, scene.parent):
        with pytest.raises(
            ssduck.SelectScriptError, match="is a link that leads out of its folder"
        ):
            opening.load(path, zygote=zygote)


@pytest.mark.parametrize("name", ["a [run]", "what?", "a*b", "[x].duckdb", "run"])
def test_a_record_whose_path_is_a_pattern_is_that_record(tmp_path, zygote, name):
    folder = tmp_path / "of [many]"
    folder.mkdir()
    record, secret = folder / name, tmp_path / "secret"
    secret.write_text("x")
    if name.endswith(".duckdb"):
        with ssduck.load("kitchen", record) as ss:
            ss.run(0.1)
    else:
        with ssduck.load("kitchen") as ss:
            ss.run(0.1)
            ss.export(record)
    ask = "SELECT count(*), max(tick), sum(x) FROM entities_history"
    with opening.open_record(record, zygote=zygote) as ss, ssduck.open(record) as here:
        assert ss.sql(ask).fetchall() == here.sql(ask).fetchall()
        assert ss.eval("z(kitchen{0.05}.fridge);") == here.eval("z(kitchen{0.05}.fridge);")
        with pytest.raises(SandboxError, match="Permission denied"):
            ss.ask("worker.python", f"open({str(secret)!r})")
        with pytest.raises(SandboxError, match="Permission denied"):
            ss.ask("worker.python", f"__import__('os').listdir({str(folder)!r})")


@pytest.mark.parametrize("error", [FunctionError("AS points: no memory"), MemoryError()])
def test_what_lacks_memory_is_a_limit(error):
    if not isinstance(error, MemoryError):
        error.__cause__ = MemoryError()
    assert isinstance(error_of(told_error(error)), LimitError)
    assert isinstance(error_of(told_error(FunctionError("AS points: none"))), FunctionError)
