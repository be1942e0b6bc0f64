"""Files and folders of odd names, through all doors but records, which `test_record_paths` has."""

import json
import os
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest
from PIL import Image
from typer.testing import CliRunner

import ssduck
from ssduck.adapters.grid_values import OccupancyGrid
from ssduck.cli.app import app
from ssduck.errors import ArgumentError, RecordError, SqlError, UnknownNameError
from tests.support.cases import sampled
from tests.support.urdf import box_obj, collision, link, robot

pytestmark = pytest.mark.skipif(os.name != "posix", reason="such names are for POSIX")

# A file `run1` beside is what `run[1]` would find as a pattern.
NAMES = ["run[1]", 'x*\' "q" #%41d;$HOME{a}', "-a\nü→ ?&=", "~\\a, b"]
# No file of these can be stored: DuckDB takes a backslash for a slash, and looks for the log of
# a file in a folder with a question mark in another one.
NO_DUCKDB = ("\\", "?")
MESH = collision('<mesh filename="cube.obj"/>') + collision('<mesh filename="cube.obj"/>').replace(
    "collision", "visual"
)


def command(*arguments):
    """What the command line writes."""
    result = CliRunner().invoke(app, list(map(str, arguments)), prog_name="ssduck")
    assert result.exit_code == 0, result.output
    return result.stdout


@pytest.fixture(params=NAMES, ids=range(len(NAMES)))
def place(request, tmp_path):
    """A folder of an odd name with a scene and a mesh in it, and that name."""
    name = request.param
    for folder in ("run1", name):
        (tmp_path / folder).mkdir()
    inside = tmp_path / name
    (inside / "cube.obj").write_text(box_obj((-0.5,) * 3, (0.5,) * 3))
    (inside / f"{name}.urdf").write_text(robot(link("base", shapes=MESH), name="cube"))
    told = f'[[body]]\nname = "cube"\nurdf = {json.dumps(f"{name}.urdf")}\nposition = [0, 0, 1]\n'
    (inside / f"{name}.toml").write_text(f'name = "lab"\n{told}', encoding="utf-8")
    return inside, name


@pytest.mark.slow
def test_scenes_models_and_what_is_written(place):
    folder, name = place
    with ssduck.load(folder / f"{name}.toml") as ss:
        world = ss.call_variable("lab")
        assert world["cube"].aabb == ([-0.5, -0.5, 0.5], [0.5, 0.5, 1.5])
        saved = world.save(folder / f"saved {name}")
        file = str(folder / f"{name}.parquet")
        ss.add_variable("rows", ss.eval("SELECT id, z FROM lab AS list;"))
        quoted = file.replace("\\", "\\\\").replace("'", "\\'") if "'" in file else file
        assert ss.eval(f"SELECT id, z FROM lab AS parquet('{quoted}');") == file
        assert pq.read_table(Path(file)).to_pylist() == [{"id": "cube", "z": 1.0}]
        if not any(letter in file for letter in "\\"):
            told = ss.sql("FROM read_parquet($1)", [_exactly(file)]).fetchall()
            assert told == [("cube", 1.0)]
        cloud = ss.eval("SELECT this FROM lab AS points(0.2);").save(folder / f"{name}.ply")
        assert cloud.stat().st_size > 100
    for scene in (saved, folder / f"{name}.urdf"):
        with ssduck.load(scene) as ss:
            assert [len(entity.links) for entity in ss.worlds[0]] == [1]


def _exactly(path):
    """A path as a pattern that finds nothing else."""
    return "".join(f"[{letter}]" if letter in "*?[" else letter for letter in path)


@pytest.mark.slow
def test_maps_and_pictures(place):
    folder, name = place
    grid = OccupancyGrid(np.eye(5, dtype=bool), (0.0, 1.0), 0.1, 0.5)
    for path in (folder / f"{name}.yaml", folder / name):
        stored = grid.save(path)
        assert (OccupancyGrid.load(stored).cells == grid.cells).all()
    picture = folder / f"{name}.png"
    command("demo", folder / f"{name}.toml", "--output", picture)
    with Image.open(picture) as image:
        assert image.size > (100, 100)


@pytest.mark.slow
def test_the_command_line(place):
    folder, name = place
    scene = folder / f"{name}.toml"
    assert command("query", "--format", "json", scene, "SELECT id FROM lab AS list;")
    records = [folder / f"of {name}"]
    if not any(letter in str(folder) for letter in NO_DUCKDB):
        records.append(folder / f"{name}.duckdb")
    for record in records:
        command("record", scene, "--seconds", "0.02", "--output", record)
        if record.suffix != ".duckdb" and "\\" in str(record):
            continue  # it can be read where DuckDB is not asked for rows
        assert "lab" in command("episodes", record)
        assert "cube" in command("query", record, "SELECT id FROM lab{0} AS list;")
        assert "cube" in command("query", record, "--sql", "SELECT name FROM entities_history")
        written = folder / f"again {name} {record.suffix}"
        command("export", record, "--output", written)
        (one,), (other,) = ssduck.episodes(record), ssduck.episodes(written)
        assert one.ticks == other.ticks > 1


# Names that no file can have, or none that DuckDB or PyBullet take.
IMPOSSIBLE = ["null\0x", "surrogate\udcff"]


@pytest.mark.parametrize("name", IMPOSSIBLE)
def test_names_that_no_file_can_have(client, tmp_path, name):
    world = ssduck.World.attach(client)
    ss = ssduck.Interpreter()
    ss.add_variable("lab", world)
    grid = OccupancyGrid(np.eye(5, dtype=bool), (0.0, 1.0), 0.1, 0.5)
    ss.add_variable("file", str(tmp_path / name))
    for act, error in (
        (lambda: ss.export(tmp_path / name), RecordError),
        (lambda: ss.record_to(tmp_path / name), RecordError),
        (lambda: ssduck.open(tmp_path / name), RecordError),
        (lambda: ssduck.Interpreter(tmp_path / name), SqlError),
        (lambda: ss.eval("SELECT id FROM lab AS parquet(file);"), ArgumentError),
        (lambda: grid.save(tmp_path / f"{name}.yaml"), ArgumentError),
        (lambda: ssduck.load(tmp_path / f"{name}.urdf"), UnknownNameError),
    ):
        with pytest.raises(error) as caught:
            act()
        assert "\n" not in caught.value.message
    assert not list(tmp_path.iterdir())


def test_a_model_whose_name_is_no_text(tmp_path):
    path = tmp_path / "surrogate\udcff.urdf"
    path.write_text(robot(link("base"), name="cube"))
    with ssduck.load(path, simulator="pybullet") as ss:
        (world,) = ss.worlds
        assert [entity.name for entity in world] == ["surrogate"]


@pytest.mark.slow
def test_a_duckdb_file_in_a_folder_with_a_question_mark(client, tmp_path):
    for name in ("a?b", "?"):
        (tmp_path / name).mkdir()
        with pytest.raises(SqlError, match="question mark"):
            ssduck.Interpreter(tmp_path / name / "run.duckdb")
        assert not list((tmp_path / name).iterdir())
    ss = ssduck.Interpreter(tmp_path / "run?.duckdb")  # the file itself may be called so
    ss.add_variable("lab", ssduck.World.attach(client))
    ss.close()
    assert ssduck.episodes(tmp_path / "run?.duckdb")[0].ticks == 1


# -- names of worlds -------------------------------------------------------------------------


@pytest.mark.slow
@sampled("letter", ["a", "ü"], every=2)
def test_a_world_of_a_name_that_no_file_can_have(client, tmp_path, letter):
    """One for which there is room, one that is a little too long, and one that is far too long."""
    world = ssduck.World.attach(client)
    room, size = os.pathconf(tmp_path, "PC_NAME_MAX"), len(letter.encode())
    fits = letter * ((room - len("-1000000.json.damaged-10")) // size)
    for name in (letter * (room // size), letter * 1000):
        with ssduck.Interpreter() as ss:
            ss.add_variable(name, world)
            for store in (ss.export, ss.record_to):
                with pytest.raises(RecordError, match="bind it to a shorter name"):
                    store(tmp_path / "run", name)
        assert not list((tmp_path / "run").rglob("*"))
    with ssduck.Interpreter() as ss:
        ss.add_variable(fits, world)
        with ss.record_to(tmp_path / "run", fits):
            world.tick()
        ss.export(tmp_path / "run", fits)
    assert [episode.ticks for episode in ssduck.episodes(tmp_path / "run")] == [2, 2]
    with ssduck.open(tmp_path / "run") as opened:
        assert len(opened.sql("FROM ticks_history")) == 2
