"""Records from strangers in folders: nothing outside is read, and what is wrong is an error."""

import json
import shutil
from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq
import pytest

import ssduck
from ssduck.errors import RecordError
from tests.support.cases import sampled
from tests.support.forged import (
    EPISODE,
    describe,
    part,
    rewrite,
    rewrite_log,
    use,
    with_column,
    without_checksums,
)

ABOUT = "episodes/lab-0.json"


@pytest.fixture(scope="module")
def made(tmp_path_factory, small_records):
    place = shutil.copytree(small_records, tmp_path_factory.mktemp("forged") / "made")
    for name in ("folder", "unfinished"):
        without_checksums(place / name)
    return place


@pytest.fixture
def folder(made, tmp_path):
    """A valid record in a folder."""
    return Path(shutil.copytree(made / "folder", tmp_path / "folder"))


def text(name, content):
    as_bytes = content if isinstance(content, bytes) else content.encode()
    return lambda record: (record / name).write_bytes(as_bytes)


def about(**values):
    return lambda record: describe(record / ABOUT, **values)


def rows(table, change):
    return lambda record: rewrite(part(record, table), change)


def column(table, name, values):
    return rows(table, with_column(name, values))


def moved(old, new):
    return lambda record: shutil.move(record / old, record / new)


ENTITIES, TICKS = f"entities/{EPISODE}/part-000000.parquet", f"ticks/{EPISODE}/part-000000.parquet"
# (name, change, words of the error)
ATTACKS = [
    ("no UTF-8", text("ssduck.json", b"\xff\xfe{}"), "ssduck.json is damaged: .*utf-8"),
    ("empty", text("ssduck.json", ""), "ssduck.json is damaged: Expecting value"),
    ("a huge number", text("ssduck.json", '{"version": 1' + "0" * 5000 + "}"), "is damaged: Exceeds"),
    ("a version of 10**30", lambda r: describe(r / "ssduck.json", version=10**30), "install a newer"),
    ("tables elsewhere", about(tables=["ticks", "entities", "../../other"]), "'tables' is to be a list"),
    ("an absolute table", about(tables=["ticks", "entities", "/etc"]), "'tables' is to be a list"),
    ("a model as a table", about(tables=["ticks", "entities", "models/links"]), "'tables' is to be"),
    ("NUL in a table", about(tables=["ticks", "entities", "a\0b"]), "'tables' is to be a list"),
    ("a table twice", about(tables=["ticks", "entities", "ticks"]), "'tables' is to be a list"),
    ("no ticks", about(tables=["entities"]), "'tables' is to be a list"),
    ("every 2**70", about(recording={"every": 2**70}), "'every' is to be a number of ticks"),
    ("every true", about(recording={"every": True}), "'every' is to be a number of ticks"),
    ("entities", about(recording={"entities": [1]}), "'entities' is to be a list of names"),
    ("parts", about(parts={"ticks": "1"}), "'ticks' is to be a number of parts"),
    ("many parts", about(parts={"models": 10**15}), "part-000001.parquet is missing"),
    ("a key of numbers", about(key=5), "'key' is to be a text"),
    ("a key of another", about(key="0" * 16), "is another part, or of another record"),
    ("a tag of a list", about(tags={"a": [1]}), "is damaged: 'tags' is to be"),
    ("a list of tags", about(tags=["a"]), "is damaged: 'tags' is to be"),
    ("an id of a name", about(id="lab"), "is damaged: 'id' is to be"),
    ("another episode", about(episode=1), "describes episode 1 of 'lab'"),
    ("another world", about(world="../lab"), r"describes episode 0 of '\.\./lab'"),
    ("a folder as a part", lambda r: (part(r, "links").unlink(), part(r, "links").mkdir()), "Is a directory"),
    ("a part of 10**8", lambda r: shutil.copy(part(r, "ticks"), part(r, "ticks", 10**8)),
     "part-000001.parquet is missing, and parts after it"),
    ("zero bytes", text(ENTITIES, b""), "is damaged: it is no complete Parquet file"),
    ("zeros", text(TICKS, b"PAR1" + bytes(100) + b"\x20\0\0\0PAR1"), "part-000000.parquet"),
    ("another file", lambda r: pq.write_table(pa.table({"a": [1]}), part(r, "entities")),
     "is another part, or of another record"),
    ("no rows of ticks", rows("ticks", lambda t: t.slice(0, 0)), "ticks/.* is damaged: a part has no ticks"),
    ("no models", rows("models/entities", lambda t: t.slice(0, 0)), "a row is of an unknown entity"),
    ("a tick twice", column("ticks", "tick", lambda v: v[:1] * len(v)), "its ticks do not ascend"),
    ("ticks < 0", column("ticks", "tick", lambda v: [n - 1000 for n in v]), "is out of bounds"),
    ("a tick of 2**63 - 1", column("ticks", "tick", lambda v: [*v[:-1], 2**63 - 1]), "out of bounds"),
    ("ticks in NULL", column("ticks", "tick", lambda v: [None, *v[1:]]), "lacks its number or its time"),
    ("NaN as a time", column("ticks", "time", lambda v: [float("nan"), *v[1:]]), "times of its ticks"),
    ("times that fall", column("ticks", "time", lambda v: v[::-1]), "the times of its ticks do not"),
    ("an infinite time", column("ticks", "time", lambda v: [*v[:-1], float("inf")]), "times of its"),
    *(
        (f"{table}: {name} of another type", column(table, name, lambda v, t=kind: pa.nulls(len(v), t)),
         f"{table}/.*its column '{name}' has the type {kind}")
        for table, name, kind in [
            ("ticks", "time", pa.float32()), ("entities", "id", pa.int32()),
            ("entities", "x", pa.binary()), ("models/entities", "run", pa.uint64()),
            ("models/geometries", "faces", pa.int16()),
        ]
    ),
    *(
        (f"{table} without {name}", rows(table, lambda t, n=name: t.drop_columns([n])),
         f"{table}/.*lacks the column '{name}'")
        for table, name in [
            ("ticks", "time"), ("entities", "id"), ("entities", "qw"), ("entities", "run"), ("links", "link"),
            ("contacts", "a"), ("models/entities", "kind"), ("models/shapes", "geometry"),
            ("models/joints", "axis_x"), ("models/geometries", "vertices"),
        ]
    ),
    ("vertices of two numbers", column("models/geometries", "vertices", lambda v: pa.array(
        [[[0.0, 0.0]] * 8 for _ in v])), "models/geometries/.*cannot be read"),
    ("faces", column("models/geometries", "faces", lambda v: [[[0, 1, 10**9]] for _ in v]),
     "refers to a missing vertex"),
    ("of other digits", moved(ABOUT, "episodes/lab-\u0660.json"), "lab-0.json is missing"),
    ("of a longer number", moved(ABOUT, "episodes/lab-000.json"), "lab-0.json is missing"),
    ("of a world with a quote", moved(ABOUT, "episodes/la'b-0.json"), "lab-0.json is missing"),
]  # fmt: skip


@sampled(("change", "words"), [a[1:] for a in ATTACKS], every=4, ids=[a[0] for a in ATTACKS])
def test_a_forged_folder_is_an_error(folder, change, words):
    change(folder)
    with pytest.raises(RecordError, match=words) as error:
        use(folder)
    assert str(folder.name) in str(error.value) or "nothing is recorded" in str(error.value)


@pytest.mark.slow
def test_the_valid_one_is_none(folder, made):
    use(folder)
    use(made / "unfinished")


@pytest.mark.long
def test_odd_numbers_are_answers(folder):
    """What a diverged simulation leaves: poses that are not finite, and quaternions of length 0."""
    for name, value in (("x", "nan"), ("y", "inf"), ("qw", "0"), ("xmax", "-inf"), ("vx", "1e308")):
        rewrite(part(folder, "entities"), with_column(name, lambda v, x=value: [float(x)] * len(v)))
        rewrite(part(folder, "links"), with_column(name, lambda v, x=value: [float(x)] * len(v)))
        use(folder)


@pytest.mark.slow
def test_further_columns_do_not_matter(folder):
    for table in ("ticks", "entities", "models/entities", "models/shapes"):
        rewrite(
            part(folder, table), lambda t: t.append_column("extra", pa.nulls(len(t), pa.binary()))
        )
    use(folder)


@pytest.mark.parametrize("world", ["main", "select", "LAB"])
def test_a_world_of_a_name_that_no_world_can_have(folder, world):
    """DuckDB or the language has the name, or another world in small letters."""
    for parts in list(folder.rglob("world=lab")):
        shutil.copytree(parts, parts.with_name(f"world={world}"))
    shutil.copy(folder / ABOUT, folder / f"episodes/{world}-0.json")
    describe(folder / f"episodes/{world}-0.json", world=world)
    with pytest.raises(RecordError, match=r"folder cannot be opened: .*cannot (have|be)"):
        ssduck.open(folder)


@pytest.mark.slow
@sampled("name", ["[a]*?", "a'b", 'a"b', "x" * 200, "a;--", "{0}", "é\U0001f986"], every=3)
def test_any_name_of_a_folder(folder, name):
    """Beside it is a folder that the name as a pattern finds."""
    shutil.copytree(folder, folder.with_name("axy"))
    use(folder.rename(folder.with_name(name)))


# -- values of JSON -----------------------------------------------------------------------------

OTHERS = [None, True, -1, 0, 2**63, 1.5, float("nan"), "", "x", "../x", [], [[]], [1], {}, {"a": 1}]


def mutations(value):
    """Yields a value with each of its parts replaced by values of other types, or removed."""
    for other in OTHERS:
        if type(other) is not type(value) or other != value:
            yield other
    if isinstance(value, dict):
        for key, part in value.items():
            yield {k: v for k, v in value.items() if k != key}
            yield from ({**value, key: changed} for changed in mutations(part))
    elif isinstance(value, list):
        for n, part in enumerate(value):
            yield from ([*value[:n], changed, *value[n + 1 :]] for changed in mutations(part))


@pytest.mark.slow
@sampled(
    ("name", "every"),
    [(name, 6) for name in ("ssduck.json", ABOUT)]
    + [pytest.param(name, 1, marks=pytest.mark.slow) for name in ("ssduck.json", ABOUT)],
    every=2,
)
def test_each_value_of_a_description(folder, name, every):
    """A value of another type is an error that names the file, or does not matter."""
    content = json.loads((folder / name).read_text())
    content.pop("crc32", None)  # a wrong checksum would be the only error
    outcomes = {"error": 0, "answer": 0}
    for changed in list(mutations(content))[::every]:
        (folder / name).write_text(json.dumps(changed))
        try:
            with ssduck.open(folder) as ss:
                assert len(ss.past("lab").ticks) > 1
            outcomes["answer"] += 1
        except RecordError as error:
            assert "folder" in str(error)
            outcomes["error"] += 1
    assert outcomes["error"] > 5 * outcomes["answer"] > 0 or name == "ssduck.json"


def test_a_check_tells_of_ticks(folder):
    column("ticks", "tick", lambda v: v[:1] * len(v))(folder)
    (damage,) = ssduck.check(folder)
    assert damage.loss == "all of episode 0 of 'lab'"
    assert "its ticks do not ascend" in damage.problem


# -- the log -------------------------------------------------------------------------------------


def _change(table, change):
    return lambda tables: tables.update({table: change(tables[table])})


LOG_ATTACKS = [
    ("a table less", lambda t: t.pop("contacts"), "its tables are not those recorded|contacts"),
    ("an unknown table", lambda t: t.update(x=t["ticks"]), "'x' is no table"),
    ("another type", _change("entities", with_column("x", lambda v: pa.array(list(map(str, v))))),
     "entities is damaged: its column 'x' has the type string"),
    ("a column less", _change("entities", lambda t: t.drop_columns(["id"])), "lacks the column 'id'"),
    ("an unknown entity", _change("entities", with_column("id", lambda v: [77] * len(v))),
     "a row of (entities|shapes|links|joints) is of an unknown entity"),
    ("another tick", _change("ticks", with_column("tick", lambda v: [2**62] * len(v))), "out of bounds"),
    ("a joint of another", _change("joints", with_column("joint", lambda v: [9] * len(v))),
     "a row of joints is of an unknown entity"),
]  # fmt: skip


@pytest.mark.parametrize(
    ("change", "words"), [a[1:] for a in LOG_ATTACKS], ids=[a[0] for a in LOG_ATTACKS]
)
def test_a_forged_log_is_an_error(made, tmp_path, change, words):
    record = Path(shutil.copytree(made / "unfinished", tmp_path / "unfinished"))
    rewrite_log(record, change)
    with pytest.raises(RecordError, match=words) as error:
        use(record)
    assert "unfinished" in str(error.value)


@pytest.mark.slow
def test_a_log_of_random_bytes(made, tmp_path):
    """Each byte that differs is an error, or one that nobody reads."""
    record = Path(shutil.copytree(made / "unfinished", tmp_path / "unfinished"))
    file = next(record.glob("log/*/*/part-000000-0000.arrow"))
    content = file.read_bytes()
    failed = 0
    for place in range(0, len(content), 397):
        file.write_bytes(content[:place] + bytes([content[place] ^ 0xFF]) + content[place + 1 :])
        try:
            ssduck.open(record).close()
        except RecordError:
            failed += 1
    assert failed > 5
