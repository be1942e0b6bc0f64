"""Plain DuckDB answers relations over the Parquet of a record as ssduck does."""

import math
import shutil

import duckdb
import polars as pl
import pybullet
import pytest

import ssduck
from ssduck.errors import NumberError, RecordError, UnknownNameError
from ssduck.interchange.macros import macro_script, pairs_of
from ssduck.interpreter.archives import folder_run
from ssduck.language.intervals import RELATIONS_OF_INTERVALS
from ssduck.sql.relations.registry import RELATIONS
from tests.support.cases import sampled
from tests.support.command_line import answer, ssduck_
from tests.support.forged import flip_bit
from tests.support.recorded import ALL, live_lab

WITHIN = 0.5
# Values of parameters that are no entities, by type.
VALUES = {
    "double": ("0.25", "0.001"),
    "integer": ("2", "3"),
    "place": ("{'x': 0.5, 'y': 0.5, 'z': 0.5}",),
}
# The relations that need shapes or joints.
SHAPES = {
    *(
        "penetration",
        "clearance",
        "touching",
        "contactGap",
        "nearestPoints",
        "on",
        "onTop",
        "supports",
    ),
    *("restsOn", "inside", "contains", "enclosed", "nextTo", "solidVolume"),
}
JOINTS = {"joint", "openness", "isOpen", "isClosed"}
PAIRED = {"collides", "collision", "near"}
CONTACTS = {"inContact", "hasContact", "contactForce", "grasped", "force", "torque"}
SENSINGS = {"isSensing", "sensingAmount", "sensingEnvIDs"}
FORMS = {
    f"is{form}"
    for form in ("Box", "Sphere", "Cylinder", "Capsule", "Ellipsoid", "Plane", "TriMesh")
}


@pytest.fixture(scope="module")
def record(tmp_path_factory, archive):
    """A record of a world that changes on its way, with a sensor, contacts and pairs."""
    return archive.copy(write_lab, tmp_path_factory.mktemp("macros") / "it's [1]")


def write_lab(place):
    client = pybullet.connect(pybullet.DIRECT)
    with ssduck.Interpreter(recording=ALL) as ss:
        live_lab(ss, client)
        ss.export(place, pairs=WITHIN)
    pybullet.disconnect(client)


@pytest.fixture(scope="module")
def opened(record):
    with ssduck.open(record) as ss:
        yield ss


@pytest.fixture(scope="module")
def plain(record):
    with duckdb.connect() as connection:
        connection.execute(macro_script(run=folder_run(record, None, None)).text)
        yield connection


def calls():
    """Each relation that plain DuckDB can have, with each number of arguments, as a call."""
    names = [name for name in RELATIONS if name not in SHAPES | JOINTS]
    result = []
    for name in names:
        relation = RELATIONS[name]
        for count in relation.expressions:
            rows = iter("abb")
            values = {type: iter(texts) for type, texts in VALUES.items()}
            arguments = [
                next(rows) if p.type == "entity" or name == "distance" else next(values[p.type])
                if p.type != "place" else VALUES["place"][0]
                for p in relation.parameters[:count]
            ]  # fmt: skip
            sources = "ab" if "b" in arguments else "a"
            result.append((name, f'"{name}"({", ".join(arguments)})', sources))
    return result


def same(found, expected):
    if isinstance(expected, float) and isinstance(found, float):
        return (
            found == expected
            or math.isclose(found, expected, rel_tol=1e-12, abs_tol=1e-15)
            or (math.isnan(found) and math.isnan(expected))
        )
    if isinstance(expected, list | tuple) and isinstance(found, list | tuple):
        return len(found) == len(expected) and all(map(same, found, expected))
    return found == expected and type(found) is type(expected)


@pytest.mark.parametrize("table", ["entities", "links"])
@sampled(("name", "call", "sources"), calls(), every=2)
def test_each_macro_answers_as_ssduck(opened, plain, name, call, sources, table):
    if table == "links" and (name in PAIRED or name in SENSINGS | {"environmentID", "hasBody"}):
        pytest.skip("of entities only")

    last = opened.past("lab").ticks[-1] - 20

    def query(history, schema=""):
        second = f" JOIN {schema}entities{history} b USING (tick)" if sources == "ab" else ""
        ids = "a.id, b.id" if sources == "ab" else "a.id"
        first = f"{schema}{table}{history} a"
        # ssduck's SQL knows the forms of what is there at the last tick only
        still = f" WHERE a.tick > {last}" if name in FORMS else ""
        return f"SELECT tick, {ids}, {call} FROM {first}{second}{still} ORDER BY ALL"

    expected = opened.sql(query("_history", "lab.")).fetchall()
    found = plain.execute(query("")).fetchall()
    assert len(found) == len(expected) >= 60
    wrong = [pair for pair in zip(found, expected, strict=True) if not same(*pair)]
    assert not wrong, wrong[:5]


@pytest.mark.slow
def test_some_answers_differ_from_row_to_row(plain):
    """Equal answers could be those of nothing at all."""
    for call in (
        "above(a, b)",
        "inContact(a, b)",
        "isSensing(a, b)",
        "collides(a, b)",
        "near(a, b, 0.25)",
    ):
        rows = plain.execute(
            f"SELECT count(*) FILTER ({call}), count(*) FILTER (NOT {call}) FROM entities a "
            "JOIN entities b USING (tick)"
        ).fetchone()
        assert min(rows) > 0, call
    forces = plain.execute("SELECT count(DISTINCT force(e)) FROM entities e").fetchone()
    assert forces[0] > 10


def test_intervals_and_their_relations(plain):
    plain.execute(
        "CREATE TEMP VIEW held AS SELECT tick, time, any_value(z) < 0.15 AS holds FROM entities "
        "WHERE name = 'other' GROUP BY ALL"
    )
    found = plain.execute("FROM intervals('held')").fetchall()
    assert found[0][0] < found[0][1]
    value = "[0.0, 1.0]"
    for name in RELATIONS_OF_INTERVALS:
        ((found,),) = plain.execute(f"SELECT {name}({value}, {value})").fetchall()
        assert isinstance(found, bool)


@pytest.mark.slow
def test_without_a_record_there_are_formulas():
    script = macro_script()
    lookups = SHAPES | JOINTS | PAIRED | CONTACTS | SENSINGS | FORMS | {"settled"}
    assert set(script.missing) == lookups
    assert set(script.names) == (set(RELATIONS) - lookups) | set(RELATIONS_OF_INTERVALS)
    for name in lookups:
        assert f" {name}" in script.text.partition("CREATE")[0]


@pytest.mark.slow
def test_with_a_record_only_shapes_and_joints_are_missing(record):
    script = macro_script(run=folder_run(record, "lab", 0))
    assert set(script.missing) == SHAPES | JOINTS


@pytest.mark.slow
def test_what_is_not_recorded_is_missing(tmp_path):
    ssduck.write_record(tmp_path / "r", ["a", "b"], {"a": [0, 0, 1], "b": [0, 0, 0]}, [0.0])
    script = macro_script(run=folder_run(tmp_path / "r", None, None))
    assert set(script.missing) == SHAPES | JOINTS | PAIRED | CONTACTS | SENSINGS
    with duckdb.connect() as connection:
        connection.execute(script.text)
        rows = connection.execute(
            "SELECT a.name, b.name FROM entities a, entities b WHERE below(a, b)"
        ).fetchall()
    with ssduck.open(tmp_path / "r") as ss:
        asked = "SELECT a.name, b.name FROM entities a, entities b WHERE below(a, b)"
        assert rows == ss.sql(asked).fetchall() != []


@pytest.mark.slow
def test_frames_of_pandas_and_polars_are_asked_by_duckdb(record):
    files = sorted((record / "entities").rglob("*.parquet"))
    polars_frame = pl.concat([pl.read_parquet(file, glob=False) for file in files])
    pandas_frame = polars_frame.to_pandas()
    with duckdb.connect() as connection:
        connection.execute(macro_script(["above", "distance"]).text)
        counts = []
        for frame in (polars_frame, pandas_frame):
            connection.register("frame", frame)
            query = "SELECT count(*) FROM frame a JOIN frame b USING (tick) WHERE above(a, b)"
            counts += connection.execute(query).fetchall()
    with ssduck.open(record) as ss:
        query = (
            "SELECT count(*) FROM lab.entities_history a JOIN lab.entities_history b USING (tick) "
            "WHERE above(a, b)"
        )
        assert {*counts} == {ss.sql(query).fetchone()} != {(0,)}


# -- pairs --------------------------------------------------------------------------------------


@pytest.mark.slow
def test_the_table_of_pairs_has_all_that_are_near(record, plain, tmp_path):
    _, within = pairs_of(folder_run(record, None, None))
    assert within == WITHIN
    with ssduck.open(record) as ss:
        expected = ss.sql(
            "SELECT a.tick, a.id, b.id, clearance(a, b), penetration(a, b) "
            "FROM lab.entities_history a JOIN lab.entities_history b ON a.tick = b.tick "
            "WHERE a.id < b.id AND clearance(a, b) <= 0.5 ORDER BY ALL"
        ).fetchall()
    found = plain.execute("SELECT tick, a, b, clearance, depth FROM pairs ORDER BY ALL").fetchall()
    assert found == expected
    assert len(found) > 20
    assert ssduck.check(record) == []
    copy = shutil.copytree(record, tmp_path / "copy")
    file, _ = pairs_of(folder_run(copy, None, None))
    flip_bit(file, 0.1)
    with pytest.raises(RecordError, match="damaged"):
        macro_script(run=folder_run(copy, None, None))
    (damage,) = ssduck.check(copy)
    assert (damage.file, damage.loss) == (file, "the table of pairs, for other tools")


@pytest.mark.slow
def test_pairs_of_a_part_of_a_record(record, tmp_path):
    with ssduck.open(record) as ss:
        ss.export(tmp_path / "r", entities=["board", "other"], start=0.05, end=0.1, pairs=0.1)
        with pytest.raises(NumberError, match="less than 0"):
            ss.export(tmp_path / "s", pairs=-1)
    run = folder_run(tmp_path / "r", None, None)
    rows = duckdb.sql(f"SELECT min(time), max(time), count(DISTINCT a) FROM '{pairs_of(run)[0]}'")
    low, high, entities = rows.fetchall()[0]
    assert (0.05 <= low < high <= 0.1 + 1e-9, entities) == (True, 1)
    assert not (tmp_path / "s").exists()


@pytest.mark.parametrize(
    ("call", "message"),
    [("near(a, b, 0.75)", "within 0.5 m"), ("collides(l, b)", "entities, and no links")],
)
def test_what_the_table_of_pairs_cannot_tell_is_an_error(plain, call, message):
    sources = "entities a JOIN entities b USING (tick) JOIN links l USING (tick)"
    with pytest.raises(duckdb.Error, match=message):
        plain.execute(f"SELECT count(*) FILTER ({call}) FROM {sources}").fetchall()


# -- the command --------------------------------------------------------------------------------


@pytest.mark.slow
def test_the_command_writes_a_script(record, tmp_path):
    copy = str(tmp_path / "copy")
    answer("export", str(record), "-o", copy, "--pairs", "0.1")
    written = answer("macros", "--of", copy, "-o", str(tmp_path / "m.sql"))
    assert written == ""
    with duckdb.connect(tmp_path / "kept.duckdb") as connection:
        connection.execute((tmp_path / "m.sql").read_text())
    with duckdb.connect(tmp_path / "kept.duckdb") as connection:  # they are kept in a file
        asked = "SELECT count(*) FROM entities a JOIN entities b USING (tick) WHERE {}"
        assert connection.execute(asked.format("above(a, b)")).fetchone()[0] > 0
        assert connection.execute(asked.format("near(a, b, 0.1)")).fetchone()[0] > 0
    assert answer("macros", "above").count("CREATE") == 1


@pytest.mark.slow
@pytest.mark.filterwarnings("default")
def test_a_relation_that_is_not_written_is_a_warning():
    result = ssduck_("macros", "above", "near")
    assert result.stdout.count("CREATE") == 1
    assert "near is not written: it is of shapes, which only ssduck compares" in result.stderr
    assert "is not written" not in ssduck_("macros").stderr


def test_a_wrong_name_is_an_error():
    with pytest.raises(UnknownNameError, match="did you mean 'above'"):
        macro_script(["abvoe"])
    assert ssduck_("macros", "--episode", "1").exit_code == 2


def test_several_worlds_need_a_name(tmp_path):
    for world in ("one", "two"):
        ssduck.write_record(tmp_path, ["a"], {"a": [0, 0, 0]}, [0.0], world=world)
    with pytest.raises(RecordError, match="several worlds: one, two"):
        folder_run(tmp_path, None, None)
    assert folder_run(tmp_path, "two", None).world == "two"
