"""The demonstrations: that they find what they are to find, and would tell if they did not."""

import inspect
import math
import random
import re
import shutil
import sys
from collections import deque
from itertools import pairwise

import duckdb
import pytest
from PIL import Image
from typer.testing import CliRunner

import ssduck
from ssduck.cli.app import app
from ssduck.demos import (
    NAMES,
    chaos,
    cleanup,
    description_of,
    environment,
    prolog,
    reasoning,
    robots,
    run_of,
)
from ssduck.demos.floor import SearchGrid, TopView, free_cells, shortest_path
from ssduck.demos.results import keep
from ssduck.errors import SelectScriptError

pytestmark = pytest.mark.slow


def ssduck_(*arguments):
    return CliRunner().invoke(app, arguments, prog_name="ssduck")


# -- the registry, and the command -----------------------------------------------------------


@pytest.mark.parametrize("name", NAMES)
def test_a_demonstration_is_told_and_run_like_the_others(name):
    assert re.fullmatch(r"[A-Z].{20,}[.]", description_of(name))
    parameters = list(inspect.signature(run_of(name)).parameters.values())
    assert [p.name for p in parameters[:3]] == ["folder", "say", "seed"]
    assert all(p.default is not inspect.Parameter.empty for p in parameters[3:])


def test_they_are_listed():
    result = ssduck_("demo", "--list")
    assert result.exit_code == 0
    for name in NAMES:
        assert re.search(
            rf"^{name} +{re.escape(description_of(name))}$", result.stdout, re.MULTILINE
        )


WRONG = [
    (["reasonin"], 1, "there is no demonstration 'reasonin'", "did you mean 'reasoning'?"),
    (["kitchn"], 1, "neither a shipped one", "did you mean 'kitchen'?"),
    (["robots", "--no-picture"], 2, "are for scenes", ""),
    (["robots", "--no-sql"], 2, "are for scenes", ""),
    (["chaos", "-o", "a.png"], 2, "are for scenes", ""),
    (["kitchen", "-o", "a.png", "--out", "b"], 2, "--output and --out exclude each other", ""),
    (["kitchen", "--out", "file/folder"], 1, "file/folder cannot be created: Not a directory", ""),
    (["robots", "--seed", "-1"], 2, "--seed", ""),
]


@pytest.mark.parametrize(("arguments", "code", "told", "nearest"), WRONG)
def test_what_is_wrong_is_told(tmp_path, monkeypatch, arguments, code, told, nearest):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "file").write_text("")
    result = ssduck_("demo", *arguments)
    assert result.exit_code == code
    assert told in result.stderr
    assert nearest in result.stderr
    assert [path.name for path in tmp_path.iterdir()] == ["file"]


@pytest.mark.parametrize("succeeds", [True, False])
def test_the_exit_status_tells_whether_it_succeeded(tmp_path, monkeypatch, succeeds):
    def run(folder, say, *, seed):
        say(f"seed {seed}, {folder.is_dir()}")
        return succeeds

    monkeypatch.setattr(robots, "run", run)
    result = ssduck_("demo", "robots", "--seed", "7", "--out", str(tmp_path / "new" / "folder"))
    assert result.stdout == "seed 7, True\n"
    assert result.exit_code == (0 if succeeds else 1)
    assert ("did not succeed" in result.stderr) != succeeds


def test_a_scene_is_asked_too(tmp_path):
    result = ssduck_("demo", "hall", "--out", str(tmp_path), "--no-sql")
    assert result.exit_code == 0
    assert "rover" in result.stdout
    assert "as SQL" not in result.stdout
    assert [path.name for path in tmp_path.iterdir()] == ["hall.png"]


# -- pictures --------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def hall():
    with ssduck.load("hall") as ss:
        yield ss.call_variable("hall")


def test_what_is_drawn_lies_where_it_is_seen(hall):
    """The mark of the goal is red, and its edge is 0.3 m from its middle."""
    view = TopView(hall, (0, 0), (12, 8), width=600)
    x, y, _ = hall["goal"].position

    def is_red(at):
        r, g, _ = view.image.getpixel(tuple(map(round, view.pixel(at))))
        return r > 90 and g < 60

    around = [k * math.pi / 4 for k in range(8)]
    assert all(is_red((x + 0.24 * math.cos(a), y + 0.24 * math.sin(a))) for a in around)
    assert not any(is_red((x + 0.36 * math.cos(a), y + 0.36 * math.sin(a))) for a in around)


# -- places and ways -------------------------------------------------------------------------


def steps(free, start, goal):
    """How many straight steps it takes, breadth first; None if there is no way."""
    far, waiting = {start: 0}, deque([start])
    while waiting:
        x, y = waiting.popleft()
        for cell in ((x + 1, y), (x - 1, y), (x, y + 1), (x, y - 1)):
            if cell in free and cell not in far:
                far[cell] = far[x, y] + 1
                waiting.append(cell)
    return far.get(goal)


@pytest.mark.parametrize("seed", range(20))
@pytest.mark.parametrize("diagonal", [False, True])
def test_a_way_is_a_shortest_one(seed, diagonal):
    draw = random.Random(seed)  # noqa: S311
    free = {(x, y) for x in range(9) for y in range(7) if draw.random() < 0.65} | {(0, 0), (8, 6)}
    way = shortest_path(free, (0, 0), (8, 6), diagonal=diagonal)
    least = steps(free, (0, 0), (8, 6))
    if not way:
        assert least is None
        return
    assert (way[0], way[-1]) == ((0, 0), (8, 6))
    assert set(way) <= free
    lengths = [math.dist(a, b) for a, b in pairwise(way)]
    assert max(lengths) <= (math.sqrt(2) if diagonal else 1)
    if not diagonal:
        assert len(way) - 1 == least
    elif least is not None:
        assert sum(lengths) <= least


def test_a_way_to_where_one_is():
    assert shortest_path([], (2, 3), (2, 3)) == [(2, 3)]


def test_free_cells_are_those_where_nothing_is_near():
    """The record and the narrow phase of one tick, against what-if worlds one by one."""
    grid = SearchGrid((0.7, 3.3), 0.7, (6, 4))
    with ssduck.load("hall") as ss:
        hall = ss.call_variable("hall")
        near_at = reasoning.obstacles_of(hall["rover"], 0.1, ("floor", "goal"))
        expected = {cell for cell in grid.cells() if not near_at(*grid.place(cell))}
        assert free_cells(ss, hall["rover"], grid, 0.1, ("floor", "goal")) == expected
        assert 4 < len(expected) < 20


def test_what_is_in_the_way_is_named(hall):
    near_at = reasoning.obstacles_of(hall["rover"], 0.1, ("floor", "goal"))
    x, y, _ = hall["pillar_1"].position
    assert near_at(x, y) == ["pillar_1"]
    assert near_at(x + 0.24 + 0.2 + 0.099, y) == ["pillar_1"]
    assert near_at(x + 0.24 + 0.2 + 0.101, y) == []
    x, y, _ = hall["table_1"].position
    assert near_at(x, y) == []  # it fits under a table


@pytest.mark.parametrize(("place", "cell"), [((0.6, 0.6), (0, 0)), ((0.99, 0.2), (1, -1))])
def test_the_cell_of_a_place(place, cell):
    assert reasoning.GRID.cell(place) == cell
    assert (cell in reasoning.GRID) == (min(cell) >= 0)


# -- reasoning -------------------------------------------------------------------------------


def test_reasoning(tmp_path):
    said = []
    assert reasoning.run(tmp_path, said.append, seed=0)
    (found,) = [re.search(r"a way of (\d+) steps", text) for text in said if "found a way" in text]
    (least,) = [re.search(r"Dijkstra: (\d+) steps", text) for text in said if "Dijkstra" in text]
    assert found[1] == least[1]
    assert any("no collision" in text for text in said)
    with Image.open(tmp_path / "reasoning.png") as picture:
        assert picture.width > 900  # with axes and a legend
        assert picture.height > 610


def test_no_way_to_a_cell_beyond_the_grid(monkeypatch):
    """Of a grid of four cells the goal is none."""
    monkeypatch.setattr(reasoning, "GRID", SearchGrid((0.6, 0.6), 0.4, (2, 2)))
    said = []
    with ssduck.load("hall") as ss:
        assert reasoning.query_path(ss, (0, 0), (5, 5), said.append) == []
    assert "no way" in said[0]


def test_a_drive_through_a_pillar_is_noticed():
    with ssduck.load("hall") as ss:
        x, y, _ = ss.call_variable("hall")["pillar_1"].position
        cell = reasoning.GRID.cell((x, y))
        _, hits = reasoning.drive(ss, [(cell[0], cell[1] - 3), cell])
        assert {hit["id"] for hit in hits} == {"pillar_1"}


# -- robots ----------------------------------------------------------------------------------


@pytest.mark.long
def test_robots(tmp_path):
    said = []
    assert robots.run(tmp_path, said.append, seed=3, trips=1)
    assert sum("drives to" in text for text in said) == 2
    assert sum("collides with nothing" in text for text in said) == 2
    assert any(re.search(r"barrett_4918_laser_scaner +roomba_625x", text) for text in said)
    assert (tmp_path / "robots.png").stat().st_size > 10_000


def test_robots_that_collide_and_sights_that_differ_are_noticed():
    said = []
    with robots.still_kitchen() as ss:
        ss.record("kitchen", ssduck.Recording(tables=("entities", "sensings")))
        kitchen = ss.call_variable("kitchen")
        watch = robots.Watch(kitchen)
        ss.add_trigger("seen", robots.SENSED, 0.0, watch)
        kitchen.step()
        assert robots.history_agrees(ss, watch)
        assert robots.collisions(ss, said.append) == []
        x, y, z = kitchen["roomba_625x"].position
        kitchen["roomba_625x"].move([x, y, z - 0.01])  # into the floor
        assert {hit["id"] for hit in robots.collisions(ss, said.append)} == {"kitchen"}
        tick, time, seen = watch.callbacks[-1]
        watch.callbacks[-1] = tick, time, seen - {next(iter(seen))}
        assert not robots.history_agrees(ss, watch)


def test_spans_of_sights():
    class World:
        time = 9.0

    watch = robots.Watch(World())
    a, b = ("eye", "one"), ("eye", "two")
    watch.callbacks = [
        (1, 0.0, frozenset()),
        (2, 1.0, frozenset({a})),
        (3, 2.0, frozenset({a, b})),
        (4, 4.0, frozenset({b})),
        (5, 5.0, frozenset({a, b})),
    ]
    assert watch.spans() == [(1.0, 4.0, *a), (2.0, 9.0, *b), (5.0, 9.0, *a)]


# -- cleanup ---------------------------------------------------------------------------------


def test_the_recorded_run_is_asked(tmp_path):
    said = []
    assert cleanup.run(tmp_path, said.append, seed=0)
    assert said[1] == cleanup.JOB
    assert said[2] == "To be taken to the sink: cup_905a, cup_58a2, cup_b6af, cup_d441."
    assert "cup_905a: is in the sink, at (0.24, 2.13, 0.80)." in said
    assert said[-4:-2] == [
        "On the table: no cup.",
        "In the sink: cup_905a, cup_58a2, cup_b6af, cup_d441.",
    ]
    assert "python -m examples.cleanup" in said[-1]
    assert len([*tmp_path.glob("cleanup_?_*.png")]) == 6
    held = (tmp_path / "cleanup_1_holding_cup_b6af.png").read_bytes()
    assert held != (tmp_path / "cleanup_0_before.png").read_bytes()


def test_the_answers_are_those_of_the_record(monkeypatch, tmp_path):
    """By DuckDB alone: where the cups are, when the run ends, and how deep the narrow phase finds the robot."""
    entities = f"read_parquet('{cleanup.RUN}/entities/**/*.parquet')"
    last = duckdb.sql(
        f"""SELECT c.name FROM {entities} c JOIN {entities} s USING (tick)
        WHERE c.name LIKE 'cup%' AND s.name = 'sink' AND c.x BETWEEN s.xmin AND s.xmax
        AND c.y BETWEEN s.ymin AND s.ymax AND c.z >= s.zmax
        AND tick = (SELECT max(tick) FROM {entities}) ORDER BY c.id"""
    ).fetchall()
    ((seconds,),) = duckdb.sql(f"SELECT max(time) - min(time) FROM {entities}").fetchall()
    said = []
    monkeypatch.setattr(cleanup, "ALLOWED", 5e-5)  # the robot was deeper than that
    assert not cleanup.run(tmp_path, said.append, seed=0)
    assert f"In the sink: {', '.join(name for (name,) in last)}." in said
    assert said[-2].startswith(f"{seconds:.0f} s of simulation; the robot was at most 0.09 mm deep")


def test_a_run_of_another_seed_is_not_there(tmp_path):
    result = ssduck_("demo", "cleanup", "--seed", "1", "--out", str(tmp_path))
    assert result.exit_code == 1
    assert "has the seed 0, not 1" in result.stderr
    assert "python -m examples.cleanup --seed 1" in result.stderr


# -- chaos -----------------------------------------------------------------------------------


def test_chaos(tmp_path):
    said = []
    assert chaos.run(tmp_path, said.append, seed=5, seconds=2)
    assert any(re.search(r"^ +1 +\d+ +\d+ +[\d.]+$", text, re.MULTILINE) for text in said)
    assert any("Out of the box: nobody" in text for text in said)
    with Image.open(tmp_path / "chaos.png") as picture:
        assert picture.width == 720
        legend = picture.convert("RGB").crop((536, 540, 720, picture.height))  # beside the axes
        colours = {colour for _, colour in legend.getcolors(2**24)}
        assert colours >= set(chaos._COLLISIONS.values())


# (overlaps, others, whether the first are among the others)
AMONG = [
    ({}, {}, True),
    ({(5, 1, 2): 0.01}, {(5, 1, 2): 0.01}, True),
    ({(5, 1, 2): 0.01}, {(6, 1, 2): 0.01}, True),
    ({(5, 1, 2): 0.01}, {(4, 1, 2): 0.01}, True),
    ({(5, 1, 2): 0.01}, {(7, 1, 2): 0.01}, False),
    ({(5, 1, 2): 0.01}, {(5, 1, 3): 0.01}, False),
    ({(5, 1, 2): 0.001}, {}, True),
    ({(5, 1, 2): 0.0011}, {}, False),
]


@pytest.mark.parametrize(("some", "others", "among"), AMONG)
def test_overlaps_among_others(some, others, among):
    assert chaos._are_among(some, others) == among


# -- sub-scenes, maps, clauses ---------------------------------------------------------------------------


def test_an_environment(tmp_path, monkeypatch):
    told = []
    assert run_of("environment")(tmp_path, told.append, seed=0)
    with Image.open(tmp_path / "environment.png") as picture:
        assert picture.size == (640, 480)
    assert (tmp_path / "near_roomba" / "scene.toml").is_file()
    monkeypatch.setattr(environment, "TOLERANCE", 0.0)
    (tmp_path / "again").mkdir()
    assert not environment.run(tmp_path / "again", told.append, seed=0)


def test_maps_of_the_kitchen(tmp_path):
    told = []
    assert run_of("map")(tmp_path, told.append, seed=0)
    assert any("20 separate things" in line for line in told)
    sizes = {}
    for name in ("kitchen", "near_roomba"):
        with Image.open(tmp_path / f"{name}.pgm") as picture:
            sizes[name] = picture.size
        assert f"image: {name}.pgm" in (tmp_path / f"{name}.yaml").read_text()
        with Image.open(tmp_path / f"{name}.png") as picture:
            assert min(picture.size) > 400  # enlarged, with axes
    assert sizes["near_roomba"] < sizes["kitchen"]


@pytest.mark.long
@pytest.mark.parametrize("out", [[], ["--out", "together"]])
def test_demonstrations_overwrite_nothing(tmp_path, monkeypatch, out):
    """Neither what another one made nor a user's file; one that is run again finds its own."""
    monkeypatch.chdir(tmp_path)
    folder = tmp_path / "together" if out else tmp_path / "ssduck-demo" / "kitchen"
    folder.mkdir(parents=True)
    (folder / "kitchen.png").write_text("mine")
    (folder / "near_roomba").mkdir()
    contents = []
    names = ("kitchen", "map", "environment", "prolog") if out else ("kitchen", "map")
    for name in names * 2:
        result = (
            ssduck_("demo", name, "--no-sql", *out)
            if name == "kitchen"
            else (ssduck_("demo", name, *out))
        )
        assert (result.exit_code, result.stderr) == (0, "")
        found = {path: path.read_bytes() for path in tmp_path.rglob("*") if path.is_file()}
        for before in contents:
            assert before.items() <= found.items()
        contents.append(found)
    assert contents[-1] == contents[len(names) - 1]  # the second round made nothing new
    assert (folder / "kitchen.png").read_text() == "mine"
    assert not any((folder / "near_roomba").iterdir())
    pictures = folder if out else tmp_path / "ssduck-demo" / "map"
    assert (pictures / ("kitchen_3.png" if out else "kitchen.png")).is_file()


def test_what_is_kept_beside_what_is_there(tmp_path):
    def write(text):
        return lambda path: (path.write_text(text), path.with_suffix(".other").write_text("o"))

    target = tmp_path / "it.txt"
    assert keep(target, write("a")) == target
    assert keep(target, write("a")) == target
    assert keep(target, write("b")) == tmp_path / "it_2.txt"
    assert keep(target, write("c")) == tmp_path / "it_3.txt"
    assert keep(target, write("b")) == tmp_path / "it_2.txt"
    assert sorted(path.name for path in tmp_path.iterdir()) == [
        *("it.other", "it.txt", "it_2.other", "it_2.txt", "it_3.other", "it_3.txt")
    ]
    assert target.read_text() == "a"
    with pytest.raises(SelectScriptError, match="cannot be written: No such file"):
        keep(tmp_path / "no" / "it.txt", write("a"))


ENGINES = [
    pytest.param(
        "SWI-Prolog", marks=pytest.mark.skipif(not shutil.which("swipl"), reason="no swipl")
    ),
    "clingo",
]


@pytest.mark.parametrize("engine", ENGINES)
def test_clauses_are_asked(tmp_path, monkeypatch, engine):
    if engine == "clingo":
        monkeypatch.setattr(prolog.shutil, "which", lambda _: None)
    told = []
    assert prolog.run(tmp_path, told.append, seed=0)
    assert f"The questions are put to {engine}" in told
    assert told.count("SelectScript says the same") == 3
    assert "above(table,cup_58a2).\n" in (tmp_path / "kitchen.pl").read_text()


def test_nobody_to_be_asked(tmp_path, monkeypatch):
    monkeypatch.setattr(prolog.shutil, "which", lambda _: None)
    monkeypatch.setitem(sys.modules, "clingo", None)
    told = []
    assert prolog.run(tmp_path, told.append, seed=0)
    assert (
        "Neither SWI-Prolog (the program swipl, https://www.swi-prolog.org) nor clingo "
        "(pip install clingo) is here to be asked: these are SelectScript's own answers"
    ) in told
    assert told.count("SelectScript says the same") == 0
    assert any(line.startswith("?- above(table, X).\n   X = cup_58a2, ") for line in told)


def test_other_answers_are_told(tmp_path, monkeypatch):
    monkeypatch.setattr(prolog.shutil, "which", lambda _: "swipl")
    monkeypatch.setattr(prolog, "_prolog", lambda ss, target, number: ["cup_58a2"])
    told = []
    assert not prolog.run(tmp_path, told.append, seed=0)
    assert "SelectScript says ['kitchen']" in told


def test_a_prolog_that_fails_is_told_of(tmp_path, monkeypatch, write):
    broken = write("bin/swipl", "#!/bin/sh\necho no library >&2\nexit 3\n")
    broken.chmod(0o755)
    monkeypatch.setenv("PATH", str(broken.parent), prepend=":")
    result = ssduck_("demo", "prolog", "--out", str(tmp_path))
    assert result.exit_code == 1
    assert "error: swipl failed: no library" in result.stderr
