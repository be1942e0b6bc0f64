"""`Lake.sql`: a statement that plain DuckDB, or Spark, answers as the episodes do by themselves."""

import json
import shutil
import sys

import duckdb
import numpy as np
import pyarrow as pa
import pytest
import sqlglot
from sqlglot import exp

import ssduck
from ssduck.errors import ArgumentError, SelectScriptError, UnknownNameError, UnsupportedError
from tests.support.cases import sampled

# Programs of formulas, of each kind.
PROGRAMS = (
    "holds(above(sim.table, sim.cup));",
    "holds(z(sim.cup) > 0.4498);",
    "holds(z(sim.cup) > 0.4498, -0.06);",
    "holds(z(sim.cup) > 9);",
    "since(z(sim.cup) > 0.4498);",
    "since(z(sim.cup) > 9);",
    "heldFor(z(sim.cup) > 0.4498);",
    "heldFor(z(sim.cup) > 9);",
    "changes(x(sim.gripper) > -0.49);",
    "changes(name(sim.cup));",
    "least(distance(sim.gripper, sim.cup));",
    "least(z(sim.cup), -0.05);",
    "greatest(speed(sim.cup));",
    "initially(z(sim.cup));",
    "z(sim.cup) - 0.3;",
    "z(sim.cup) > 0.4 AND x(sim.cup) < 0;",
    "SELECT id, x, z FROM sim WHERE x(this) > 0.2;",
    "SELECT time, z FROM sim{-0.05} WHERE id = 'cup';",
    "SELECT tick, z FROM sim{} WHERE id = 'cup' AND above(sim.table, this) LIMIT 3;",
    "SELECT a.this AS p, b.this AS q FROM a=sim, b=sim WHERE above(a.this, b.this);",
    "SELECT name(this) AS n, z FROM sim ORDER BY distance(this, sim.cup) DESC LIMIT 3 OFFSET 1;",
    "SELECT this FROM sim WHERE z > z(sim.cup) + 0.01 * 2;",
    "SELECT this AS path, z AS error FROM sim WHERE this == sim.cup;",
)
# One of each kind: Spark takes a second or more for each.
FOR_SPARK = tuple(PROGRAMS[place] for place in (2, 3, 4, 7, 9, 10, 12, 13, 17, 19, 20, 21))


def plain(value):
    """Returns a value with structs as lists, as `Lake.ask` gives them."""
    if hasattr(value, "asDict"):  # a row of Spark
        value = value.asDict()
    if isinstance(value, dict):
        return [plain(part) for part in value.values()]
    return [plain(part) for part in value] if isinstance(value, list | tuple) else value


def asked(lake, program):
    """Returns the rows of the answers of a lake."""
    rows = [plain(list(row.values())) for row in lake.ask(program, processes=1).to_pylist()]
    for row in rows:  # lists of several types are texts of JSON
        if isinstance(row[3], str) and row[3].startswith("["):
            row[3] = json.loads(row[3])
    return rows


def answered(lake, program):
    """Returns the rows that DuckDB gives for a lake's statement."""
    with duckdb.connect() as connection:
        return plain(connection.execute(lake.sql(program)).fetchall())


@pytest.fixture(scope="module")
def lake(recorded):
    return ssduck.lake(recorded)


@pytest.mark.slow
@sampled("program", PROGRAMS, every=4)
def test_duckdb_answers_as_the_episodes(lake, program):
    wanted = asked(lake, program)
    assert wanted
    assert answered(lake, program) == wanted


@pytest.mark.slow
@sampled("program", PROGRAMS, every=3)
def test_the_statement_for_spark_is_one(lake, program):
    text = lake.sql(program, dialect="spark")
    (tree,) = sqlglot.parse(text, dialect="spark")
    assert isinstance(tree, exp.Select)
    assert not list(tree.find_all(exp.Anonymous)), "functions of DuckDB's"
    sources = {table.name for table in tree.find_all(exp.Table) if table.db == "parquet"}
    assert f"{lake.path}/entities/world=sim" in sources


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::FutureWarning", "ignore::ResourceWarning")
@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")
def test_spark_answers_as_the_episodes(folder, tmp_path, monkeypatch):
    pytest.importorskip("pyspark", reason="PySpark is not installed: pip install 'ssduck[spark]'")
    if shutil.which("java") is None:
        pytest.skip("Spark needs Java: openjdk-17-jre-headless")
    from pyspark.sql import SparkSession

    monkeypatch.setenv("PYSPARK_PYTHON", sys.executable)
    odd = shutil.copytree(folder, tmp_path / "o'dd [*]`{1,2}" / "record")
    builder = SparkSession.builder.master("local[1]").config("spark.ui.enabled", "false")
    settings = {
        "spark.driver.host": "127.0.0.1",
        "spark.sql.codegen.wholeStage": "false",  # few rows are not worth compiled code
        "spark.sql.shuffle.partitions": "1",
    }
    for name, value in settings.items():
        builder = builder.config(name, value)
    session = builder.getOrCreate()
    try:
        lake = ssduck.lake(odd)
        for program in FOR_SPARK:
            rows = session.sql(lake.sql(program, dialect="spark")).collect()
            assert plain([tuple(row) for row in rows]) == asked(lake, program), program
    finally:
        session.stop()


# -- lakes of several kinds -------------------------------------------------------------------


def write_cups(folder, *, count, heights, first=0.0):
    """Writes an episode with some cups that rise; the last one is not there at first."""
    names = [f"cup_{n}" for n in range(count)]
    rows = {"time": [], "name": [], "x": [], "y": [], "z": []}
    for tick, height in enumerate(heights):
        for place, name in enumerate(names):
            if place == count - 1 and tick == 0:
                continue
            values = (first + tick / 10, name, 0.1 * place, 0.0, height + place)
            for column, value in zip(rows.values(), values, strict=True):
                column.append(value)
    ssduck.write_record(folder, names, pa.table(rows), world="lab", tags={"count": count})


@pytest.fixture
def mixed(tmp_path):
    """A lake of three records: of two kinds of episodes, in paths with odd names."""
    top = tmp_path / "it's [a] *lake?"
    write_cups(top / "one", count=2, heights=np.linspace(0, 1, 9))
    write_cups(top / "one", count=2, heights=np.linspace(1, 0, 5), first=3.0)
    write_cups(top / 'two "quoted"', count=3, heights=np.linspace(0, 1, 7))
    write_cups(top / "three", count=2, heights=[0.5, 0.5])
    return top


@pytest.mark.slow
@sampled(
    "program",
    [
        "holds(z(lab.cup_0) >= 0.5);",
        "changes(z(lab.cup_1) > 1.5);",
        "initially(z(lab.cup_1));",
        "since(z(lab.cup_1) >= 1.5);",
        "least(distance(lab.cup_0, lab.cup_1));",
        "SELECT this, z FROM lab WHERE distance(this, lab.cup_0) < 2;",
        "SELECT a.time AS t, a.this AS p, b.this AS q FROM a=lab{}, b=lab{} WHERE a.z < b.z;",
    ],
    every=2,
)
def test_records_with_other_entities(mixed, program):
    lake = ssduck.lake(mixed)
    assert len({entry.group for entry in lake.entries}) > 1
    wanted = asked(lake, program)
    assert all(row[-1] is None for row in wanted)
    assert answered(lake, program) == wanted


@pytest.mark.slow
def test_a_damaged_episode_is_a_row_with_its_error(mixed):
    (mixed / "three/episodes/lab-0.json").write_text("{")
    for program in ("z(lab.cup_0);", "SELECT id, z FROM lab;"):
        lake = ssduck.lake(mixed)
        wanted = asked(lake, program)
        assert len([row for row in wanted if row[-1] is not None]) == 1
        assert answered(lake, program) == wanted


@pytest.mark.slow
def test_of_ticks_of_the_same_time_the_last_counts(tmp_path, monkeypatch):
    # Other writers may write such ticks; ours does not.
    monkeypatch.setattr("ssduck.interchange.pose_batches._check_order", lambda *_, **__: None)
    heights = [2.0, 1.0, 2.0, 1.0, 3.0, 2.0]
    poses = {"can": [[0.0, 0.0, height] for height in heights]}
    times = [0.0, 0.0, 0.1, 0.2, 0.2, 0.2]
    ssduck.write_record(tmp_path / "record", ["can"], poses, times, world="lab")
    lake = ssduck.lake(tmp_path)
    answers = []
    for program in (
        "changes(z(lab.can) > 1.5);",
        "holds(z(lab.can) > 1.5);",
        "initially(z(lab.can) > 1.5);",
        "greatest(z(lab.can));",
    ):
        rows = answered(lake, program)
        assert rows == asked(lake, program)
        answers.append(rows[0][3])
    assert answers == [[[0.0, False], [0.1, True]], [[0.1, 0.2]], False, [0.1, 2.0]]


@pytest.mark.slow
def test_only_the_selected_episodes(lake):
    with duckdb.connect() as connection:
        rows = connection.execute(lake.sql("z(sim.cup);", "episode IN (1, 3)")).fetchall()
    assert [row[1] for row in rows] == [1, 3]


# -- what is not written as SQL ---------------------------------------------------------------


@pytest.mark.parametrize(
    ("program", "message"),
    [
        ("on(sim.table, sim.cup);", "on, which compares shapes, is not written as SQL"),
        ("least(clearance(sim.cup, sim.wall));", "clearance, which compares shapes"),
        ("contactForce(sim.cup, sim.table);", "contactForce, which reads contacts"),
        ("SELECT this FROM links(sim);", "a source other than a world"),
        ("SELECT this FROM sim{0.05};", "a source other than a world"),
        ("SELECT a.z FROM a=sim, b=sim{};", "several ranges of ticks"),
        ("SELECT this FROM sim AS list;", "AS is not written as SQL"),
        ("SELECT z FROM sim WHERE z > max(SELECT z FROM sim AS list);", "a query inside"),
        ("heldFor(z(sim.cup) > 0.4) > 0.1;", "heldFor inside of another expression"),
        ("lifted(sim.cup, 0.1);", "initially inside of another expression is not written as SQL"),
        ("holds(z(sim.cup));", "holds of the type double"),
        (
            "SELECT kind, count(id) FROM sim GROUP BY kind;",
            "GROUP BY, DISTINCT or an aggregate is not",
        ),
        ("count(SELECT id FROM sim AS list);", "a query inside of another expression"),
        ("[z(sim.cup), z(sim.table)];", "since not every engine has lists like .*: .*Lake.ask"),
        ("changes(position(sim.cup));", "is not written as SQL, since not every engine has lists"),
        ("SELECT id, robot(this) AS r FROM sim;", "an entity that is not the row's own"),
        ("changes(robot(sim.cup));", "an entity that is not the row's own"),
        ("a = 1; SELECT z FROM sim WHERE z > a;", "one statement"),
    ],
)
@sampled("dialect", ["duckdb", "spark"], every=2)
def test_what_is_refused(lake, program, message, dialect):
    with pytest.raises(UnsupportedError, match=message):
        lake.sql(program, dialect=dialect)


@pytest.mark.slow
def test_mistakes(lake, tmp_path):
    with pytest.raises(UnknownNameError, match="no entity 'cop'"):
        lake.sql("z(sim.cop);")
    with pytest.raises(UnknownNameError, match=r"'sparc'.*did you mean 'spark'"):
        lake.sql("z(sim.cup);", dialect="sparc")
    with pytest.raises(ArgumentError, match="there is no episode to ask"):
        lake.sql("z(sim.cup);", "episode > 99")
    with pytest.raises(SelectScriptError):
        lake.sql("z(sim.cup")
    file = tmp_path / "own.duckdb"
    with ssduck.load("kitchen", database=file) as ss:
        ss.run(0.02)
    with pytest.raises(UnsupportedError, match=r"own\.duckdb.*no complete episode in Parquet"):
        ssduck.lake(file).sql("z(kitchen.can);")
