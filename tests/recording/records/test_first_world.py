"""Records of several worlds keep which one was added first: SQL may omit its name."""

import json

import pybullet
import pytest

import ssduck
from ssduck.recording.stores.files import json_text

# The first by name is not the first that was added.
NAMES = ("zoo", "attic", "mill")
FIRST = "SELECT name FROM entities"


@pytest.fixture
def recorded(tmp_path):
    """Records of three worlds, each with an entity of its name: a file and two folders."""
    clients = [pybullet.connect(pybullet.DIRECT) for _ in NAMES]
    with ssduck.Interpreter(tmp_path / "file.duckdb") as ss:
        for name, client in zip(NAMES, clients, strict=True):
            body = pybullet.createMultiBody(1, physicsClientId=client)
            ss.add_variable(name, ssduck.World.attach(client, names={body: f"of_{name}"}))
        # What is written first does not tell.
        with ss.record_to(tmp_path / "live", "attic"), ss.record_to(tmp_path / "live", "zoo"):
            for name in reversed(NAMES):
                ss[name].step()
        ss.export(tmp_path / "folder")
        assert ss.sql(FIRST).fetchall() == [("of_zoo",)]
    for client in clients:
        pybullet.disconnect(client)
    return tmp_path


@pytest.mark.slow
def test_sql_answers_for_the_world_that_was_added_first(recorded):
    with ssduck.open(recorded / "folder") as ss:
        for name in ("mill", "zoo"):  # copied one by one, the first one last
            ss.export(recorded / "copy", name)
    for path in ("file.duckdb", "live", "folder", "copy"):
        with ssduck.open(recorded / path) as ss:
            assert ss.sql(FIRST).fetchall() == [("of_zoo",)], path
            assert next(world.name for world in ss.worlds) == "zoo", path
    with ssduck.open(recorded / "folder", "mill") as ss:
        assert ss.sql(FIRST).fetchall() == [("of_mill",)]


@pytest.mark.slow
def test_a_record_without_an_order_begins_with_the_first_by_name(recorded):
    for file in (recorded / "folder" / "episodes").iterdir():
        about = json.loads(file.read_text())
        del about["order"], about["crc32"]
        file.write_text(json_text(about))
    with ssduck.open(recorded / "folder") as ss:
        assert ss.sql(FIRST).fetchall() == [("of_attic",)]
