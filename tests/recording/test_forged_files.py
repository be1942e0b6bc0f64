"""Records from strangers in DuckDB files: they are read as data, and what is wrong is an error."""

import json
import shutil
import sqlite3
from contextlib import closing
from pathlib import Path

import duckdb
import pytest

import ssduck
from ssduck.errors import RecordError
from tests.support.cases import sampled
from tests.support.forged import use

SCHEMA = "lab_record_0"


@pytest.fixture
def file(small_records, tmp_path):
    """A valid record in a DuckDB file, beside a file with a secret."""
    (tmp_path / "secret.txt").write_text("the secret")
    return Path(shutil.copy(small_records / "file.duckdb", tmp_path))


def place(table):
    return f'{SCHEMA}."{table}"'


def run(file, *statements):
    with duckdb.connect(file) as plain:
        for statement in statements:
            plain.execute(statement)


def about(file, **values):
    """Changes the description of the record."""
    with duckdb.connect(file) as plain:
        ((text,),) = plain.sql(f"FROM {place('ssduck record')}").fetchall()
        text = json.dumps(json.loads(text) | values)
        plain.execute(f"UPDATE {place('ssduck record')} SET about = ?", [text])


def in_place_of(table, select):
    """Returns a change that puts a view in the place of a table; {old} is the table."""

    def change(file):
        secret = file.with_name("secret.txt")
        text = select.format(old=place("old"), secret=secret)
        run(
            file,
            f'ALTER TABLE {place(table)} RENAME TO "old"',
            f"CREATE VIEW {place(table)} AS {text}",
        )

    return change


def sql(*statements):
    return lambda file: run(file, *statements)


LEAK = "SELECT * REPLACE ((SELECT content FROM read_text('{secret}')) AS name) FROM {old}"
ENTITIES, SHAPES, GEOMETRIES = (
    place("entities model"),
    place("shapes model"),
    place("geometries model"),
)
ROWS, LINK_ROWS, JOINT_ROWS, TICKS = (
    place(f"{t} 0") for t in ("entities", "links", "joints", "ticks")
)
# (name, change, words of the error)
ATTACKS = [
    ("a view as a model", in_place_of("entities model", LEAK), "'entities model' is damaged: it is"),
    *(
        (f"a view as {table}", in_place_of(table, "FROM {old}"), f"'{table}' is damaged: it is")
        for table in ("links model", "geometries model", "entities 0", "ticks 0", "contacts 0")
    ),
    ("a view as a description", in_place_of("ssduck record", "FROM {old}"), "nothing is recorded"),
    *(
        (f"names of the type {kind}",
         sql(f"ALTER TABLE {ENTITIES} ALTER name TYPE {kind} USING {value}"),
         f"its column 'name' has the type {kind}; it is to have values of the type string")
        for kind, value in (("UUID", "md5(name)::UUID"), ("JSON", "to_json(name)"))
    ),
    ("points of two numbers",
     sql(f"ALTER TABLE {GEOMETRIES} ALTER vertices TYPE DOUBLE[2][] USING [[1, 2]]::DOUBLE[2][]"),
     r"its column 'vertices' has the type DOUBLE\[2\]\[\]; it is to have values of the type points"),
    ("no model", sql(f"DROP TABLE {SHAPES}"), "'shapes model' is damaged: it is missing"),
    ("no rows", sql(f"DROP TABLE {ROWS}"), "'entities 0' is damaged: it is missing"),
    ("two descriptions", sql(f"INSERT INTO {place('ssduck record')} FROM {place('ssduck record')}"),
     "lacks its description"),
    ("no description", sql(f"DELETE FROM {place('ssduck record')}"), "lacks its description"),
    ("NULL", sql(f"UPDATE {place('ssduck record')} SET about = NULL"), "lacks its description"),
    ("a list", sql(f"UPDATE {place('ssduck record')} SET about = '[]'"), "it has no JSON object"),
    ("half an object", sql(f"UPDATE {place('ssduck record')} SET about = '{{'"),
     "the description of lab_record_0 is damaged: Expecting"),
    ("a version alone", sql(f"UPDATE {place('ssduck record')} SET about = '{{\"version\": 1}}'"),
     "lab_record_0 is damaged: it lacks what is recorded: .*'world'"),
    ("of another name", sql('CREATE SCHEMA "x y_record_0"',
     f'CREATE TABLE "x y_record_0"."ssduck record" AS FROM {place("ssduck record")}'),
     "the schema 'x y_record_0' is of no episode"),
    ("of another number", sql('CREATE SCHEMA "lab_record_00"',
     f'CREATE TABLE lab_record_00."ssduck record" AS FROM {place("ssduck record")}'),
     "is of no episode"),
    ("another version", lambda f: about(f, version=2), "of version 2; .*install a newer one"),
    ("a version of text", lambda f: about(f, version="1"), "'version' is to be a number"),
    ("no version", lambda f: about(f, version=None), "'version' is to be a number"),
    ("a recording of text", lambda f: about(f, recording="all"), "'recording' is to be an object"),
    ("an unknown setting", lambda f: about(f, recording={"x": 1}), "no valid recording settings"),
    ("tables of numbers", lambda f: about(f, recording={"tables": [1]}), "no valid recording"),
    *(
        (f"a camera: {camera}", lambda f, camera=camera: about(f, camera=camera), "a camera that sees")
        for camera in (
            [], {}, {"eye": [0, 0, 0], "target": [1, 0, 0]},
            {"eye": [0, 0, 0], "target": [0, 0, 0], "fov": 50}, {"eye": [0, 0], "target": [1, 0, 0], "fov": 50},
            {"eye": [0, 0, 0], "target": [1, 0, 0], "fov": 180},
            {"eye": [0, 0, 0], "target": [1, 0, 0], "fov": True},
            {"eye": [0, 0, "1"], "target": [1, 0, 0], "fov": 50},
        )
    ),
    ("every 0", lambda f: about(f, recording={"every": 0}), "no valid recording settings"),
    ("a column of text", sql(f"ALTER TABLE {ROWS} ALTER x TYPE VARCHAR"),
     "'entities 0' is damaged: its column 'x' has the type string"),
    ("a column of lists", sql(f"ALTER TABLE {ROWS} DROP x", f"ALTER TABLE {ROWS} ADD x DOUBLE[]"),
     r"its column 'x' has the type DOUBLE\[\]"),
    ("a missing column", sql(f"ALTER TABLE {ROWS} DROP qw"), "it lacks the column 'qw'"),
    ("a missing column of a model", sql(f"ALTER TABLE {ENTITIES} DROP kind"), "lacks the column 'kind'"),
    ("an enumeration", sql("CREATE TYPE k AS ENUM ('robot', 'kinbody', 'sensor')",
     f"ALTER TABLE {ENTITIES} ALTER kind TYPE k"), "its column 'kind' has the type ENUM"),
    ("several runs", sql(f"UPDATE {ENTITIES} SET run = id"), "its entities are of several runs"),
    ("faces", sql(f"UPDATE {GEOMETRIES} SET faces = [[0, 1, 99]]"), "refers to a missing vertex"),
    ("faces < 0", sql(f"UPDATE {GEOMETRIES} SET faces = [[0, 1, -1]]"), "refers to a missing vertex"),
    ("a tick twice", sql(f"INSERT INTO {TICKS} FROM {TICKS}"), "its ticks do not ascend"),
    ("a tick < 0", sql(f"UPDATE {TICKS} SET tick = -tick"), "the number of a tick is out of bounds"),
    ("a tick of 2**62", sql(f"UPDATE {TICKS} SET tick = tick + 4611686018427387904"), "tick is out of bounds"),
    ("no tick", sql(f"UPDATE {TICKS} SET tick = NULL WHERE tick = 3"), "lacks its number"),
    ("NaN as a time", sql(f"UPDATE {TICKS} SET time = 'nan' WHERE tick = 3"), "times of its ticks"),
    ("backwards", sql(f"UPDATE {TICKS} SET time = -time"), "the times of its ticks do not ascend"),
    ("an unknown entity", sql(f"UPDATE {ROWS} SET id = 99 WHERE id = 1"), "a row is of an unknown entity"),
    ("no links", sql(f"DELETE FROM {LINK_ROWS}"), "the links are not those of the entities"),
    ("no joints of a tick", sql(f"DELETE FROM {JOINT_ROWS}"), "the joints are not those"),
    ("the body of a sensor", sql(f"DELETE FROM {ROWS} WHERE id = (SELECT id FROM {ENTITIES} WHERE name = 'arm')"),
     "without the body that carries it"),
]  # fmt: skip


@sampled(("change", "words"), [a[1:] for a in ATTACKS], every=4, ids=[a[0] for a in ATTACKS])
def test_a_forged_file_is_an_error(file, change, words):
    change(file)
    with pytest.raises(RecordError, match=words) as error:
        use(file)
    assert str(file) in str(error.value)


@pytest.mark.slow
def test_the_valid_one_is_none(file):
    use(file)


@pytest.mark.slow
def test_a_view_of_the_file_is_not_read(file):
    """Views, macros and own tables in the schemas of the file are not ours."""
    secret, program = file.with_name("secret.txt"), "SELECT id, z FROM lab;"
    with ssduck.open(file) as ss:
        expected = ss.eval(program)
    run(
        file,
        "CREATE SCHEMA IF NOT EXISTS lab",
        f"CREATE OR REPLACE VIEW lab.entities_history AS FROM read_text('{secret}')",
        f"CREATE OR REPLACE VIEW {SCHEMA}.ticks_history AS FROM read_text('{secret}')",
        "CREATE TABLE entities AS SELECT 'mine' AS name",
        "CREATE VIEW main.links AS FROM read_text('/etc/passwd')",
        *(
            f"CREATE MACRO {name}(a) AS 'theirs'"
            for name in ("abs", "count", "main.len", "greatest", "list_value")
        ),
        "CREATE MACRO near(a, b, d) AS true",
        "CREATE MACRO range(a) AS TABLE SELECT 1",
        "CREATE MACRO collides(a, b) AS true",
        "CREATE MACRO lab.collides(a, b) AS true",
        f"CREATE MACRO unnest(a) AS TABLE FROM read_text('{secret}')",
        "CREATE SEQUENCE s",
        f"CREATE INDEX i ON {ENTITIES} (id)",
    )
    use(file)
    with ssduck.open(file, limits=ssduck.Limits.strict()) as ss:
        found = ss.sql("SELECT name, abs(-z), count(*) OVER () FROM entities").fetchall()
        assert len(found) == 6
        assert ss.eval(program) == expected
        assert {name for name, *_ in found} == {"board", "ball", "other", "arm", "mesh", "eye"}
        assert all(isinstance(z, float) and count == 6 for _, z, count in found)
        apart = "a.name = 'board' AND b.name = 'mesh'"
        ((hit,),) = ss.sql(
            f"SELECT collides(a, b) FROM entities a, entities b WHERE {apart}"
        ).fetchall()
        assert hit is False
        for statement in (
            'FROM "ssduck record file".lab.entities_history',
            f'FROM "ssduck record file".{SCHEMA}.ticks_history',
            "SELECT collides(1, 2)",
        ):
            with pytest.raises(ssduck.SelectScriptError):
                ss.sql(statement)


def test_another_type_of_file_loads_no_extension(tmp_path):
    """DuckDB would download an extension to read it."""
    with closing(sqlite3.connect(tmp_path / "run.duckdb")) as other, other:
        other.execute("CREATE TABLE t (x)")
    with pytest.raises(RecordError, match=r"run.duckdb.* is not a valid DuckDB database file"):
        ssduck.open(tmp_path / "run.duckdb")
