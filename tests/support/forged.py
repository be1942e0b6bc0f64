"""Forges records: small valid ones, made once, of which a test changes a copy."""

import json
import tarfile
from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq
import pytest

import ssduck
from ssduck import Recording
from ssduck.recording.stores.part_log import _LABEL, _TABLE
from ssduck.schema import HISTORIES, MODELS, RECORDABLE
from tests.support.recorded import lively

pybullet = pytest.importorskip("pybullet")

EPISODE = "world=lab/episode=0"
CORNERS = [[0, 0, 0], [0.1, 0, 0], [0, 0.1, 0], [0, 0, 0.1]]
FACES = [0, 2, 1, 0, 1, 3, 0, 3, 2, 1, 2, 3]
TICKS = 4
DATA = Path(__file__).parents[1] / "data"


def flip_bit(file, position=0.5):
    """Flips a bit of a file, at a part of its length."""
    content = bytearray(file.read_bytes())
    content[int(position * len(content))] ^= 4
    file.write_bytes(content)


def make_records(place):
    """Makes `folder`, `unfinished`, which has a log only, and `file.duckdb` in a place."""
    client = pybullet.connect(pybullet.DIRECT)
    names = lively(client)
    mesh = pybullet.createCollisionShape(
        pybullet.GEOM_MESH, vertices=CORNERS, indices=FACES, physicsClientId=client
    )
    names[pybullet.createMultiBody(0, mesh, basePosition=[0, 3, 0], physicsClientId=client)] = (
        "mesh"
    )
    everything = Recording(tables=RECORDABLE)
    with ssduck.Interpreter(str(place / "file.duckdb"), recording=everything) as ss:
        world = ss.add_variable("lab", ssduck.World.attach(client, names=names))
        world.add_sensor(
            "planar_laser", "arm", "eye", position=[0, -0.2, 0], max_range=3.0,
            min_angle=-30.0, max_angle=30.0, resolution=5.0,
        )  # fmt: skip
        world.step(120)  # the balls are on the board then
        folder = ss.record_to(place / "folder", recording=everything)
        for _ in range(TICKS):
            world.step()
        folder.close()
    pybullet.disconnect(client)
    with tarfile.open(DATA / "records-1.tar.xz") as packed:
        members = [member for member in packed if "unfinished" in member.name]
        packed.extractall(place, members, filter="data")
    about = place / "unfinished" / "episodes" / "lab-0.json"
    content = json.loads(about.read_text())
    del content["checksums"], content["crc32"]
    about.write_text(json.dumps(content))


def use(path):
    """Opens a record, and reads all that is in it in each way there is."""
    for episode in ssduck.episodes(path):
        assert episode.ticks
    with ssduck.open(path) as ss:
        lab = ss.call_variable("lab")
        for time in ss.past("lab").times:
            lab.seek(float(time))
            ss.eval("SELECT id, position, aabb(this) FROM lab AS list;")
        ss.eval("SELECT tick FROM lab{} WHERE touching(this, lab.arm) AS list;")
        ss.eval("SELECT distance(this, lab.arm) FROM lab{} WHERE isKinbody(this) AS list;")
        ss.eval("SELECT a.id, b.id FROM a=lab, b=lab WHERE collides(a, b) AS list;")
        ss.sql("SELECT count(*) FROM entities a, entities b WHERE collides(a, b)")
        for table in HISTORIES:
            ss.sql(f"SELECT * FROM {table}_history").fetchall()
        for table in MODELS:
            ss.sql(f"SELECT * FROM {table}_model").fetchall()


def part(record, table, number=0):
    """Returns the file of a part of a table, or of `models/<table>`."""
    return record / table / EPISODE / f"part-{number:06d}.parquet"


def rewrite(file, change):
    """Changes the rows of a part; it keeps its label."""
    rows = pq.ParquetFile(file).read()
    pq.write_table(change(rows).replace_schema_metadata(rows.schema.metadata), file)


def with_column(name, values):
    """Returns a change that replaces a column by values, or by a function of its values."""

    def change(rows):
        index = rows.column_names.index(name)
        new = values(rows[name].to_pylist()) if callable(values) else values
        kind = None if isinstance(new, pa.Array) else rows.schema.field(name).type
        column = new if isinstance(new, pa.Array) else pa.array(new, kind)
        return rows.set_column(index, name, column)

    return change


def without_checksums(record):
    """Takes the checksums of a folder away, as a stranger can: what is read is checked again."""
    for file in (record / "ssduck.json", *(record / "episodes").iterdir()):
        about = json.loads(file.read_text())
        file.write_text(
            json.dumps({k: v for k, v in about.items() if not k.startswith(("crc", "che"))})
        )
    for file in record.rglob("*.parquet"):
        rows = pq.ParquetFile(file).read()
        metadata = {k: v for k, v in rows.schema.metadata.items() if k != b"ssduck checksums"}
        pq.write_table(rows.replace_schema_metadata(metadata), file)


def describe(file, **values):
    """Changes values of a description, and removes its checksum, as a forger would."""
    content = json.loads(file.read_text()) | values
    content.pop("crc32", None)
    file.write_text(json.dumps(content))


def _streams(file):
    content, tables = pa.BufferReader(file.read_bytes()), {}
    while content.tell() < content.size():
        table = pa.ipc.open_stream(content).read_all()
        tables[table.schema.metadata[_TABLE].decode()] = table
    return tables


def rewrite_log(record, change):
    """Changes the tables of the first file of a log, by name; it keeps its label."""
    file = next(record.glob("log/*/*/part-000000-0000.arrow"))
    tables = _streams(file)
    label = tables["ticks"].schema.metadata[_LABEL]
    change(tables)
    with pa.OSFile(str(file), "wb") as sink:
        for name, table in tables.items():
            labelled = table.replace_schema_metadata({_LABEL: label, _TABLE: name})
            with pa.ipc.new_stream(sink, labelled.schema) as writer:
                writer.write_table(labelled)
