"""Maps of ROS, errors, and grids of records."""

import numpy as np
import pybullet
import pytest
import yaml
from PIL import Image

import ssduck
from ssduck.adapters.grid_values import OccupancyGrid
from ssduck.errors import ArgumentError, SelectScriptError
from ssduck.simulators.scenes import find_scene
from tests.support.cases import sampled
from tests.support.grids import ALL, BALL, GROUND, Boxes

# -- maps of ROS ---------------------------------------------------------------------------------


def test_a_map_as_others_read_it(grid, tmp_path):
    path = grid.save(tmp_path / "map")
    assert path == tmp_path / "map.yaml"
    told = dict(line.split(": ", 1) for line in path.read_text(encoding="utf-8").splitlines())
    assert list(told) == [
        "image",
        "resolution",
        "origin",
        "negate",
        "occupied_thresh",
        "free_thresh",
        "z",
    ]
    assert (told["image"], told["origin"], told["negate"]) == ("map.pgm", "[-1.0, 2.0, 0.0]", "0")
    raw = (tmp_path / "map.pgm").read_bytes()
    assert raw.split(maxsplit=4)[:4] == [b"P5", b"4", b"3", b"255"]
    with Image.open(tmp_path / "map.pgm") as picture:
        occupied = (255 - np.asarray(picture)) / 255 > float(told["occupied_thresh"])
        free = (255 - np.asarray(picture)) / 255 < float(told["free_thresh"])
    assert (occupied == ~free).all()
    # the first row is that of the greatest y
    assert np.array_equal(occupied[::-1].T, grid.cells)
    assert OccupancyGrid.load(path) == grid


@pytest.mark.slow
def test_a_map_of_a_range_of_heights(tmp_path, kitchen):
    grid = kitchen.eval(f"{ALL} map([0.2, 1.5], 0.05);")
    assert grid.z == (0.2, 1.5)
    assert OccupancyGrid.load(grid.save(tmp_path / "kitchen.yaml")) == grid


YAML = "image: m.pgm\nresolution: 0.1 # m\norigin: [1, 2.5, 0]\nnegate: {negate}\noccupied_thresh: 0.65\nfree_thresh: 0.196\n"


@pytest.mark.parametrize(
    ("negate", "unknown", "expected"),
    [
        (0, True, [[1, 1, 0]]),
        (0, False, [[1, 0, 0]]),
        ("false", False, [[1, 0, 0]]),
        (1, False, [[0, 0, 1]]),
        ("true", False, [[0, 0, 1]]),
    ],
)
def test_a_map_of_another(tmp_path, negate, unknown, expected):
    (tmp_path / "m.yaml").write_text(YAML.format(negate=negate), encoding="utf-8")
    shades = [0, 205, 254] if negate in (0, "false") else [0, 50, 255]
    Image.fromarray(np.array([shades], np.uint8)).save(tmp_path / "m.pgm")
    grid = OccupancyGrid.load(tmp_path / "m.yaml", unknown=unknown)
    assert grid.cells.T.astype(int).tolist() == expected
    assert (grid.origin, grid.resolution, grid.z) == ((1.0, 2.5), 0.1, 0.0)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (
            lambda text: text.replace("negate: 0\n", ""),
            "no map of ROS's map_server: it has no negate",
        ),
        (lambda text: text.replace("2.5, 0]", "2.5, 0.1]"), r"rotated by 0.1 rad"),
        (lambda text: text.replace("m.pgm", "n.pgm"), "cannot be read as a map: .*n.pgm"),
        (lambda text: text.replace("[1, 2.5, 0]", "1"), "cannot be read as a map"),
        (lambda text: text.replace("0.1 # m", "-0.1"), "resolution -0.1"),
        (lambda text: text.replace("0.1 # m", "0 # m"), "resolution 0"),
        (lambda text: text.replace("0.1 # m", "1e999"), "resolution inf"),
        (lambda text: text + "mode: raw\n", "the mode is raw"),
        (lambda text: text + "- x\n", r"m\.yaml cannot be read: line 7: "),
        (lambda text: text + "at: 2024-13-45\n", r"m\.yaml cannot be read: month must be"),
        (lambda text: text + "x: \x01\n", r"m\.yaml cannot be read: .*special characters"),
        (lambda text: f"[{text}", r"m\.yaml cannot be read: line "),
        (lambda text: "# nothing", "map_server: it has no image"),
        (lambda text: text, "1 cells are unknown; load"),
    ],
)
def test_maps_that_cannot_be_read(tmp_path, change, message):
    (tmp_path / "m.yaml").write_text(change(YAML.format(negate=0)), encoding="utf-8")
    Image.fromarray(np.array([[0, 205, 254]], np.uint8)).save(tmp_path / "m.pgm")
    with pytest.raises(ArgumentError, match=message):
        OccupancyGrid.load(tmp_path / "m.yaml")


def test_files_that_are_not_there(grid, tmp_path):
    with pytest.raises(ArgumentError, match=r"nowhere\.yaml cannot be read"):
        OccupancyGrid.load(tmp_path / "nowhere.yaml")
    with pytest.raises(ArgumentError, match="is the name of the picture"):
        grid.save(tmp_path / "map.pgm")
    with pytest.raises(ArgumentError, match=r"map\.yaml cannot be written: .*[Nn]o such file"):
        grid.save(tmp_path / "nowhere" / "map.yaml")


@pytest.mark.parametrize(
    "name",
    [
        "map-2.1",
        "a #b",
        "a: b",
        "- x",
        "[x]",
        "'q'",
        '"q"',
        "&x",
        "#",
        "a\nb",
        "back\\slash",
        "ü",
        "next\x85line",
        "😀",
    ],
)
def test_a_file_may_have_any_name(grid, tmp_path, name):
    path = grid.save(tmp_path / f"{name}.yaml")
    assert yaml.safe_load(path.read_bytes())["image"] == f"{name}.pgm"
    assert OccupancyGrid.load(path) == grid


# -- errors --------------------------------------------------------------------------------------


# Of all bodies: (form, message)
FORMS = [
    ("map('low', 0.1)", "z_pos is a number, not 'low'"),
    ("map(True, 0.1)", "z_pos is a number, not True"),
    ("map([1, 2, 3], 0.1)", r"z_pos is a height or \[lowest, highest\]"),
    ("map([2, 1], 0.1)", "the lowest height 2 is above the highest, 1"),
    ("map(1e999, 0.1)", "z_pos is a finite number"),
    ("map(0.2, 0)", "the size of a cell is above 0 m, not 0"),
    ("map(0.2, -1)", "above 0 m, not -1"),
    ("map(0.2, 0.1, 3)", r"bounds are two corners \[x, y\]"),
    ("map(0.2, 0.1, [[0, 0], [1]])", r"bounds is two corners"),
    ("map(0.2, 0.1, [[0, 0], [0, 1]])", "bounds: 0 is not below 0"),
    ("map(0.2, 0.00001)", "more than 100,000,000; take larger cells, or bounds of a part"),
    ("map(0.2)", "its usage: AS occupancygrid | map"),
    ("voxelgrid(0.1, [[0, 0], [1, 1]])", r"two corners \[x, y, z\]"),
    ("voxelgrid(0.001)", "more than 100,000,000"),
    ("sensorgrid(0.2, 'fine')", "the size of a cell is a number"),
    ("plane('XW', [0, 0], [1, 1, 1])", "axes are 'XY', 'XZ' or 'YZ', not 'XW'"),
    ("plane('XY', [0], [1, 1, 1])", r"origin is \[first, second\]"),
    ("plane('XY', [0, 0], [1, 1])", "size is .cells along first"),
    ("plane('XY', [0, 0], [1.5, 1, 1])", "the numbers of cells must be whole"),
    ("plane('XY', [0, 0], [1, 1, 0])", "above 0 m"),
    ("plane('XY', [0, 0], [100000, 100000, 1])", "more than 100,000,000"),
    ("map(0.2, 1e-320)", "inf x inf cells are more than 100,000,000"),
    ("map(0.2, 1e-200)", "more than 100,000,000"),
    ("plane('XY', [0, 0], [9, 9, 1], 0)", "blur is a whole number from 1 to 9, not 0"),
    ("plane('XY', [0, 0], [9, 9, 1], 10)", "blur is a whole number from 1 to 9, not 10"),
    ("plane('XY', [0, 0], [9000, 9000, 1], 9000)", "27,000 x 27,000 cells are more than"),
]
# (query, message)
QUERIES = [
    ("SELECT id FROM kitchen AS map(0.2, 0.1);", "no column holds an entity"),
    ("SELECT obj FROM kitchen WHERE False AS map(0.2, 0.1);", "has shapes; give bounds"),
    (
        "SELECT obj FROM kitchen WHERE isSensor(this) AS map(0.2, 0.1);",
        "has shapes; give bounds",
    ),
    (
        "SELECT obj FROM kitchen WHERE isRobot(this) AS sensorgrid(0.2, 0.1);",
        "no sensor is selected",
    ),
    ("SELECT obj FROM kitchen AS plane('XY', [-5,-5], [10,10,1]);", "no column has a number"),
    (
        "SELECT obj, id FROM kitchen AS plane('XY', [0, 0], [9, 9, 1]);",
        "column 'id' cannot be summed",
    ),
    (
        "SELECT mass(a.this) FROM a=kitchen, b=kitchen AS plane('XY', [0, 0], [9, 9, 1]);",
        "no column holds an entity",
    ),
]


@pytest.mark.parametrize(
    ("query", "message"), [*((f"{ALL} {form};", told) for form, told in FORMS), *QUERIES]
)
def test_what_cannot_be(kitchen, query, message):
    with pytest.raises(SelectScriptError, match=message.replace(" | ", r" \| ")) as caught:
        kitchen.eval(query)
    assert caught.value.span is not None


def test_nothing_is_empty_where_bounds_are_given(kitchen):
    empty = kitchen.eval("SELECT obj FROM kitchen WHERE False AS map(0.2, 0.1, [[0, 0], [1, 2]]);")
    assert (empty.shape, bool(empty)) == ((10, 20), False)


def test_the_box_of_an_entity_as_bounds(kitchen):
    table = "table = SELECT obj FROM kitchen WHERE id(this) == 'table' AS value;"
    grid = kitchen.eval(f"{table} SELECT obj FROM kitchen AS map(0.9, 0.05, bounds=aabb(table));")
    low, high = kitchen.call_variable("kitchen")["table"].aabb
    assert grid.origin == tuple(low[:2])
    assert grid.shape == tuple(np.ceil((np.array(high) - low)[:2] / 0.05).astype(int))


@pytest.mark.slow
def test_a_ground_without_end():
    with Boxes(([0.5, 0.5, 0.5], [0, 0, 0]), others=[GROUND]) as boxes:
        with pytest.raises(ArgumentError, match="a plane is infinite: give bounds"):
            boxes.eval("SELECT obj FROM sim AS map(0, 0.1);")
        given = "bounds=[[-1, -1], [1, 1]]"
        assert boxes.eval(f"SELECT obj FROM sim AS map(-0.6, 0.5, {given});").cells.all()
        assert boxes.eval(f"SELECT obj FROM sim AS map(-0.4, 0.5, {given});").cells.sum() == 4


def test_a_pose_that_is_no_number():
    with Boxes(([0.5, 0.5, 0.5], [0, 0, 0]), ([0.5, 0.5, 0.5], [3, 0, 0]), owned=False) as boxes:
        pybullet.resetBasePositionAndOrientation(0, [np.nan] * 3, [0, 0, 0, 1], boxes.client)
        with pytest.warns(UserWarning, match="no number"):
            boxes.world.tick()
        with pytest.raises(ArgumentError, match="'a': the pose is not a number"):
            boxes.eval("SELECT obj FROM sim AS map(0, 0.1);")
        assert boxes.eval("SELECT obj FROM sim WHERE id(this) == 'b' AS map(0, 0.1);").cells.all()


# -- records, evaluators, other ways in ----------------------------------------------------------


@pytest.mark.slow
@sampled("row_by_row", [False, True], every=2)
def test_an_opened_record_has_the_same_grids(tmp_path, row_by_row):
    queries = [
        "SELECT obj FROM kitchen AS map(0.22, 0.05);",
        "SELECT obj FROM kitchen AS voxelgrid(0.2);",
        "SELECT obj FROM kitchen WHERE isSensor(this) AS sensorgrid(0.24, 0.1);",
        "SELECT mass FROM kitchen AS plane('XY', [-5,-5], [10,10,1]);",
    ]
    world = ssduck.World.load(find_scene("kitchen")).step(3)
    with ssduck.Interpreter(row_by_row=row_by_row) as ss:
        ss.add_variable("kitchen", world)
        live = [ss.eval(query) for query in queries]
        ss.export(tmp_path / "run")
    with ssduck.open(tmp_path / "run") as record:
        assert [record.eval(query) for query in queries] == live


@pytest.mark.slow
def test_where_a_thing_was_over_time():
    """Rows of all ticks, each at its own."""
    with Boxes(others=[BALL | {"position": [0.5, 0.5, 10]}]) as boxes:
        boxes.world.step(2)
        boxes.eval("SELECT obj FROM sim AS list;")
        ticks = len(boxes.eval("SELECT obj FROM sim{} AS list;"))
        grid = boxes.eval("SELECT obj, 1 FROM sim{} AS plane('XZ', [0, 0], [2, 20, 1]);")
        assert grid.cells.sum() == ticks > 1
        with pytest.raises(ArgumentError, match="several ticks"):
            boxes.eval("SELECT obj FROM sim{} AS map(10, 0.1);")
