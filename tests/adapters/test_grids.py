"""Grids behind AS: what is occupied, what sensors see, sums over a plane; as arrays, pictures, files."""

from __future__ import annotations

import pickle
import subprocess
import sys
from pathlib import Path

import numpy as np
import pybullet
import pytest
import yaml
from PIL import Image
from scipy.spatial import ConvexHull
from scipy.spatial.transform import Rotation

import ssduck
from ssduck.adapters import grids as forms
from ssduck.adapters.grid_values import OccupancyGrid, PlaneGrid, SensorGrid, VoxelGrid
from ssduck.errors import ArgumentError, SelectScriptError
from ssduck.simulators.pybullet.simulator import PyBulletSimulator
from ssduck.simulators.scenes import find_scene
from tests.support.cases import sampled

ROOT = Path(__file__).resolve().parents[2]
ALL = "SELECT obj FROM kitchen AS"


@pytest.fixture(scope="module")
def kitchen():
    with ssduck.load("kitchen") as ss:
        ss.call_variable("kitchen").step(2)
        yield ss


BALL = {"kind": pybullet.GEOM_SPHERE, "mass": 1.0, "radius": 0.3}
GROUND = {"kind": pybullet.GEOM_PLANE, "position": [0, 0, -0.5], "planeNormal": [0, 0, 1]}


class Boxes:
    """A world of boxes that cannot move, and of others: `sim` of an interpreter; named by letters."""

    def __init__(self, *boxes, others=(), owned=True):
        self.client = pybullet.connect(pybullet.DIRECT)
        pybullet.setGravity(0, 0, -9.81, physicsClientId=self.client)
        for halves, position in boxes:
            self.add(pybullet.GEOM_BOX, position, halfExtents=halves)
        for other in others:
            self.add(**other)
        names = dict(enumerate("abcdefgh"))
        self.world = ssduck.World(PyBulletSimulator(self.client, owned=owned, names=names))
        self.ss = ssduck.Interpreter()
        self.ss.add_variable("sim", self.world)

    def add(self, kind, position, mass=0.0, **size):
        shape = pybullet.createCollisionShape(kind, physicsClientId=self.client, **size)
        pybullet.createMultiBody(mass, shape, basePosition=position, physicsClientId=self.client)

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.ss.close()
        if pybullet.isConnected(self.client):
            pybullet.disconnect(self.client)

    def eval(self, text):
        return self.ss.eval(text)


# -- what is occupied -----------------------------------------------------------------------------


def members(ss, points):
    """Whether a shape holds each point, (n,): by SQL's tables and the shapes' definitions."""
    rows = ss.sql(
        "SELECT s.xmin, s.xmax, s.ymin, s.ymax, g.type, g.size_x, g.size_y, g.size_z, g.vertices, s.x, s.y, s.z, s.qx, s.qy, s.qz, s.qw "
        "FROM shapes s JOIN geometries g ON g.id = s.geometry"
    ).fetchall()
    held = np.zeros(len(points), bool)
    for xmin, xmax, ymin, ymax, kind, a, b, c, vertices, *pose in rows:
        x, y, _ = points.T
        near = np.flatnonzero((x >= xmin) & (x <= xmax) & (y >= ymin) & (y <= ymax))
        held[near] |= is_in(points[near], kind, a, b, c, vertices, pose)
    return held


def is_in(points, kind, a, b, c, vertices, pose):
    """Whether one shape holds each point, (n,)."""
    if len(points):
        local = Rotation.from_quat(pose[3:]).inv().apply(points - pose[:3])
        if kind == "box":
            return (abs(local) <= np.array([a, b, c]) / 2).all(axis=1)
        if kind == "sphere":
            return np.linalg.norm(local, axis=1) <= a
        if kind == "cylinder":
            return (np.hypot(local[:, 0], local[:, 1]) <= a) & (abs(local[:, 2]) <= b / 2)
        assert kind == "hull"
        planes = ConvexHull(np.array(vertices)).equations
        return (local @ planes[:, :3].T + planes[:, 3] <= 0).all(axis=1)
    return np.zeros(0, bool)


def centres(grid, z):
    x, y = np.meshgrid(grid.centres(0), grid.centres(1), indexing="ij")
    return np.column_stack((x.ravel(), y.ravel(), np.full(x.size, z)))


@sampled("z", [0.22, 0.45, 1.0], every=3)
def test_the_kitchen_is_occupied_where_its_shapes_are(kitchen, z):
    grid = kitchen.eval(f"{ALL} occupancygrid({z}, 0.025);")
    corners = np.array([[0, 0], [-1, -1], [-1, 1], [1, -1], [1, 1]]) * 0.0125 * 0.9999
    held = [members(kitchen, centres(grid, z) + [*c, 0]).reshape(grid.shape) for c in corners]
    assert np.asarray(grid)[np.any(held, axis=0)].all()
    inside, outside = np.all(held, axis=0), ~np.any(held, axis=0)
    for _ in range(2):  # away from edges: the cells around are alike
        inside[1:-1, 1:-1] &= (
            inside[2:, 1:-1] & inside[:-2, 1:-1] & inside[1:-1, 2:] & inside[1:-1, :-2]
        )
        outside[1:-1, 1:-1] &= (
            outside[2:, 1:-1] & outside[:-2, 1:-1] & outside[1:-1, 2:] & outside[1:-1, :-2]
        )
    assert inside.sum() > 500
    assert outside.sum() > 5000
    assert grid.cells[inside].all()
    assert grid.cells[outside].mean() <= 0.001


def test_bounds_are_those_of_the_selected_shapes_outward_to_a_centimetre(kitchen):
    table = kitchen.eval("SELECT obj FROM kitchen WHERE id(this) == 'table' AS map(0.9, 0.01);")
    (xmin, ymin, _), (xmax, ymax, _) = kitchen.call_variable("kitchen")["table"].aabb
    assert (
        table.bounds[0] == (0.46, -1.04) == (np.floor(xmin * 100) / 100, np.floor(ymin * 100) / 100)
    )
    assert table.bounds[1] == pytest.approx((np.ceil(xmax * 100) / 100, np.ceil(ymax * 100) / 100))
    assert table.shape == (99, 175)
    assert table.z == 0.9
    assert table.cells[2:-2, 2:-2].all()


def test_the_tutorials_maps(kitchen):
    """Cells 44 to 47: bounds of all bodies to 1 cm, and one cell more than these have."""
    grid = kitchen.eval(f"{ALL} roombaGrid;")
    boxes = np.array([e.aabb for e in kitchen.call_variable("kitchen") if e.kind != "sensor"])
    low, high = np.floor(boxes[:, 0].min(0) * 100) / 100, np.ceil(boxes[:, 1].max(0) * 100) / 100
    assert grid.shape == tuple(int(n) + 1 for n in np.ceil((high - low)[:2] / 0.025))
    assert (grid.z, grid.resolution) == (0.22, 0.025)
    assert grid.origin == tuple(low[:2])
    same = kitchen.eval(f"{ALL} map(0.22, 0.025);")
    assert np.array_equal(same.cells, grid.cells[: same.shape[0], : same.shape[1]])
    near = kitchen.eval(
        "roomba = SELECT obj FROM kitchen WHERE id(this)=='roomba_625x' AS value;"
        "SELECT obj FROM kitchen WHERE distance(roomba, this) <= 1.5 AS roombaGrid;"
    )
    assert 0 < near.cells.sum() < grid.cells.sum()
    assert near.astype(float).dtype == float


TINY = 1e-6


@pytest.mark.parametrize("off", [-TINY, 0.0, TINY])
def test_a_box_is_exact(off):
    half = 0.2 + off
    with Boxes(([half, 0.3, 0.25], [0.5, 0.5, 0.25])) as boxes:
        grid = boxes.eval(
            "SELECT obj FROM sim AS occupancygrid(0.1, 0.1, bounds=[[0, 0], [1, 1]]);"
        )
        expected = np.zeros((10, 10), bool)
        expected[2 if off > 0 else 3 : 8 if off > 0 else 7, 2:8] = True
        assert np.array_equal(grid, expected)


@pytest.mark.parametrize(
    ("heights", "some"),
    [
        ("0", True),
        ("-0.000001", False),
        ("0.5", True),
        ("0.500001", False),
        ("[0.500001, 2]", False),
    ]
    + [("[0.499999, 2]", True), ("[-1, 0]", True), ("[-1, 9]", True), ("[0.2, 0.2]", True)],
)
def test_heights(heights, some):
    with Boxes(([0.5, 0.25, 0.25], [0, 0, 0.25])) as boxes:
        grid = boxes.eval(f"SELECT obj FROM sim AS occupancygrid({heights}, 0.125);")
        assert grid.shape == (8, 4)
        assert grid.cells.all() == grid.cells.any() == some
        assert bool(grid) == some


def test_voxels_are_exact():
    with Boxes(
        ([0.1, 0.2, 0.3], [0.1, 0.2, 0.3]), ([0.05, 0.05, 0.05], [0.35, 0.15, 0.25])
    ) as boxes:
        grid = boxes.eval("SELECT obj FROM sim AS voxelgrid(0.1, [[0, 0, 0], [0.5, 0.4, 0.8]]);")
        expected = np.zeros((5, 4, 8), bool)
        expected[0:2, 0:4, 0:6] = expected[3, 1, 2] = True
        assert np.array_equal(grid, expected)
        assert isinstance(grid, VoxelGrid)
        assert grid.at(0.35, 0.15, 0.25)
        assert grid.heights()[3].tolist() == pytest.approx([0, 0.3, 0, 0])
        assert boxes.eval("SELECT obj FROM sim AS voxelgrid(0.1);").shape == (4, 4, 6)


def test_layers_of_voxels_are_ranges_of_heights(kitchen):
    voxels = kitchen.eval(f"{ALL} voxelgrid(0.1);")
    for layer in (2, 5, 9):
        low = voxels.origin[2] + layer * 0.1
        flat = kitchen.eval(f"{ALL} map([{low + 2e-9!r}, {low + 0.1 - 2e-9!r}], 0.1);")
        assert np.array_equal(flat, voxels[:, :, layer])


def test_each_group_is_a_grid(kitchen):
    bounds = "bounds=[[-2, -3], [2.5, 3]]"
    groups = kitchen.eval(f"SELECT obj FROM kitchen GROUP BY type AS map(0.22, 0.05, {bounds});")
    assert set(groups) == {"sensor", "robot", "kinbody"}
    whole = kitchen.eval(f"{ALL} map(0.22, 0.05, {bounds});")
    assert np.array_equal(np.any([groups[kind].cells for kind in groups], axis=0), whole.cells)
    assert not groups["sensor"]
    assert 0 < groups["robot"].cells.sum() < whole.cells.sum()


def test_a_recorded_tick_has_its_own_grid():
    with Boxes(others=[BALL | {"position": [2, 0, 2]}]) as boxes:
        query = "SELECT obj FROM {} AS map(2.0, 0.1, [[-1, -1], [3, 1]]);"
        before = boxes.eval(query.format("sim"))
        assert before.cells.sum() > 20
        boxes.world.step(240)
        assert not boxes.eval(query.format("sim"))
        assert boxes.eval(query.format("sim{0.0}")) == before


@pytest.mark.parametrize("nested", [False, True])
def test_a_client_of_ones_own(nested):
    """Its tick has the shapes from the start, for it cannot be read again."""
    with Boxes(([0.5, 0.5, 0.5], [0, 0, 0]), owned=False) as boxes:
        query = "SELECT obj FROM sim AS map(0, 0.25)"
        value = boxes.eval(f"SELECT ({query}) FROM [1] AS value;" if nested else f"{query};")
        assert value.cells.all()
        assert value.shape == (4, 4)


def test_a_trigger_on_a_map():
    with Boxes(others=[BALL | {"position": [2, 0, 2]}]) as boxes:
        seen = []
        boxes.ss.add_trigger(
            "map", "SELECT obj FROM sim AS map(1.0, 0.5, [[-1, -1], [3, 1]]);", 0.05, seen.append
        )
        boxes.world.step(240)
        assert [bool(grid) for grid in seen][-2:] == [True, False]


# -- the class ------------------------------------------------------------------------------------


@pytest.fixture
def grid():
    cells = np.zeros((4, 3), bool)
    cells[1, 0] = cells[3, 2] = True
    return OccupancyGrid(cells, (-1.0, 2.0), 0.5, 0.22)


def test_it_is_an_array(grid):
    assert np.asarray(grid).dtype == bool
    assert np.asarray(grid, dtype=float).sum() == 2.0
    assert np.flatnonzero(grid).tolist() == [3, 11]
    assert grid[1].tolist() == [True, False, False]
    assert grid[1, 0]
    assert (len(grid), grid.shape) == (4, (4, 3))
    assert grid.bounds == ((-1.0, 2.0), (1.0, 3.5))
    assert grid.axes == "XY"
    assert grid.centres(0).tolist() == [-0.75, -0.25, 0.25, 0.75]
    with pytest.raises(ValueError, match="read-only"):
        grid.cells[0, 0] = True


@pytest.mark.parametrize(
    ("point", "value"),
    [
        ((-0.5, 2.0), True),
        ((-0.5, 2.5), False),
        ((-0.01, 2.49), True),
        ((0, 2), False),
        ((0.9, 3.4), True),
    ],
)
def test_the_cell_of_a_point(grid, point, value):
    assert grid.at(*point) is value


@pytest.mark.parametrize(
    ("point", "message"),
    [
        ((1.0, 2.0), r"not in the grid, which spans"),
        ((-1.1, 2), "not in the grid"),
        ((1,), "2 coordinates"),
    ],
)
def test_points_beyond(grid, point, message):
    with pytest.raises(ArgumentError, match=message):
        grid.at(*point)


def test_equal_grids(grid):
    same = OccupancyGrid(grid.cells.copy(), grid.origin, 0.5, 0.22)
    assert (same == grid, hash(same) == hash(grid)) == (True, True)
    others = [
        OccupancyGrid(~grid.cells, grid.origin, 0.5, 0.22),
        OccupancyGrid(grid.cells, (0.0, 2.0), 0.5, 0.22),
        OccupancyGrid(grid.cells, grid.origin, 0.5, 0.3),
        SensorGrid(grid.cells, grid.origin, 0.5, 0.22),
        grid.cells.tolist(),
    ]
    assert [other for other in others if grid == other] == []
    assert pickle.loads(pickle.dumps(grid)) == grid  # noqa: S301
    assert repr(grid) == "<OccupancyGrid: 4 x 3 cells of 0.5 m from (-1.0, 2.0)>"


def test_its_picture_has_x_to_the_right_and_y_up(grid):
    picture = np.asarray(grid.image())
    assert picture.shape == (3, 4)
    assert np.argwhere(picture < 128).tolist() == [[0, 3], [2, 1]]
    assert grid._repr_png_().startswith(b"\x89PNG")
    sums = PlaneGrid(np.array([[0.0, 1.0], [2.0, 0.5]]), (0.0, 0.0), 1.0, "XZ")
    colours = np.asarray(sums.image())
    assert colours.shape == (2, 2, 3)
    assert colours[1, 0].tolist() == [255, 255, 255]
    assert colours[1, 1].sum() == colours.sum(axis=2).min()


@pytest.fixture(scope="module")
def pictures(tmp_path_factory):
    """The pictures of the manual, drawn anew: arrays of their pixels, (y, x, 3)."""
    folder = tmp_path_factory.mktemp("pictures")
    command = [sys.executable, str(ROOT / "tools" / "draw_forms.py"), str(folder)]
    subprocess.run(command, check=True, env={"PYTHONPATH": str(ROOT)}, stdout=subprocess.DEVNULL)
    return {path.stem: pixels(path) for path in sorted(folder.glob("*.png"))}


def pixels(path):
    with Image.open(path) as picture:
        return np.asarray(picture.convert("RGB")).astype(int)


@pytest.mark.slow
def test_the_manuals_pictures_are_up_to_date(pictures):
    page = (ROOT / "docs" / "reference" / "result-forms.md").read_text(encoding="utf-8")
    assert len(pictures) == 9
    for name, drawn in pictures.items():
        path = ROOT / "docs" / "images" / f"{name}.png"
        assert f"(../images/{name}.png)" in page
        assert path.stat().st_size < 100_000
        stored = pixels(path)
        assert stored.shape == drawn.shape, f"{name}: run tools/draw_forms.py"
        # Grids are exact; renderers and fonts are not the same everywhere.
        other = (np.abs(stored - drawn).max(axis=2) > 32).mean()
        most = 0.05 if name.startswith("forms-") else 0.0
        assert other <= most, f"{name}: run tools/draw_forms.py"


@pytest.mark.slow
def test_the_pictures_show_what_they_should(pictures, tmp_path):
    """Pixels are counted by colours, and are as many a cell as the cells are drawn wide."""
    with ssduck.load("kitchen") as ss:
        bounds = "bounds=[[-1.75, -2.5], [2.45, 2.7]]"
        maps = [ss.eval(f"{ALL} map({z}, 0.02, {bounds});") for z in ("0.22", "[0.2, 1.0]")]
        roomba = ss.eval(f"{ALL} roombaGrid;")
        masses = ss.eval("SELECT mass FROM kitchen AS plane('XY', [-2, -3], [50, 60, 0.1]);")
    dark, white = ((pictures["occupancygrid"] == shade).all(axis=2).sum() for shade in (40, 255))
    assert dark == 4 * sum(grid.cells.sum() for grid in maps)
    assert white == 4 * sum((~grid.cells).sum() for grid in maps)
    dark = (pictures["roombagrid"] == 40).all(axis=2)
    assert dark[:, : 12 + 2 * roomba.shape[0]].sum() == 4 * roomba.cells.sum()
    left = pictures["plane"][:, : 12 + 6 * 50]
    assert ((left != 255).any(axis=2) & (left != [200, 210, 220]).any(axis=2)).sum() == 36 * (
        np.rint(masses.cells / masses.cells.max() * 255) > 0
    ).sum()
    seen = pictures["sensorgrid"]
    assert (seen == 40).all(axis=2).sum() > 20_000
    assert (seen == [74, 0, 60]).all(axis=2).sum() > 0  # where most sensors see
    for name in ("forms-image", "forms-environment", "forms-points", "forms-graph"):
        assert 0.02 < (pictures[name] != 255).any(axis=2).mean() < 0.9
    assert len(np.unique(pictures["voxelgrid"].reshape(-1, 3), axis=0)) > 20


def test_plot(grid):
    matplotlib = pytest.importorskip("matplotlib")
    matplotlib.use("Agg")
    ax = grid.plot()
    assert ax.get_xlabel() == "x [m]"
    assert ax.images[0].get_extent() == [-1.0, 1.0, 2.0, 3.5]
    assert np.asarray(ax.images[0].get_array()).tolist() == grid.cells.T.tolist()
    sums = PlaneGrid(np.eye(2), (0.0, 0.0), 1.0, "XZ")
    assert sums.plot(ax) is ax
    assert ax.get_ylabel() == "z [m]"


def test_plot_without_matplotlib(grid, monkeypatch):
    monkeypatch.setitem(sys.modules, "matplotlib.figure", None)
    with pytest.raises(ArgumentError, match=r"pip install 'ssduck\[plot\]'"):
        grid.plot()


# -- maps of ROS ----------------------------------------------------------------------------------


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


# -- what sensors see -----------------------------------------------------------------------------

MAST = ([0.01, 0.01, 0.01], [0, 0, 0])
LIDAR = {"max_range": 4.0, "min_elevation": -90.0, "max_elevation": 90.0, "resolution": 10.0}
SEEN = "SELECT obj FROM sim WHERE isSensor(this) AS sensorgrid({z}, 0.1, [[-3, -3], [3, 3]]);"


def crosses(points, low, high):
    """Whether segments from the origin to points (n, d) meet a box, by slabs."""
    with np.errstate(divide="ignore", invalid="ignore"):
        one, two = low / points, high / points
    enter, leave = np.minimum(one, two).max(axis=1), np.maximum(one, two).min(axis=1)
    return (enter <= leave) & (enter <= 1) & (leave >= 0)


@pytest.mark.parametrize("z", [0.0, 0.4, -0.8])
def test_a_box_casts_a_shadow(z):
    with Boxes(([0.01, 0.01, 0.01], [0, 0, 0]), ([0.1, 0.4, 0.2], [1.0, 0.3, 0.1])) as boxes:
        boxes.world.add_sensor("lidar", "a", **LIDAR)
        grid = boxes.eval(SEEN.format(z=z))
        points = centres(grid, z)
        seen = np.linalg.norm(points, axis=1) <= 4.0
        seen &= ~crosses(points, np.array([0.9, -0.1, -0.1]), np.array([1.1, 0.7, 0.3]))
        assert np.array_equal(grid.cells.ravel(), seen)
        assert (grid.sensors, grid.z) == (("a_lidar",), z)
        assert (~seen).sum() > 0


@pytest.mark.parametrize("kind", ["sphere", "cylinder", "capsule"])
def test_round_things_cast_shadows(kind):
    size = {"radius": 0.3} if kind == "sphere" else {"radius": 0.3, "height": 1.0}
    shape = {"kind": getattr(pybullet, f"GEOM_{kind.upper()}"), "position": [1, 0.2, 0], **size}
    with Boxes(MAST, others=[shape]) as boxes:
        boxes.world.add_sensor("lidar", "a", **LIDAR)
        grid = boxes.eval(SEEN.format(z=0.0))
        points = centres(grid, 0.0)[:, :2]
        share = np.clip(points @ [1, 0.2] / (points**2).sum(axis=1), 0, 1)
        blocked = np.linalg.norm(share[:, None] * points - [1, 0.2], axis=1) <= 0.3
        blocked |= np.linalg.norm(points, axis=1) > 4.0
        assert np.array_equal(grid.cells.ravel() == 0, blocked)


def test_the_ground_hides_what_is_under_it():
    with Boxes(MAST, others=[GROUND]) as boxes:
        boxes.world.add_sensor("lidar", "a", **LIDAR)
        assert boxes.eval(SEEN.format(z=-0.4)).cells.sum() > 3000
        assert boxes.eval(SEEN.format(z=-0.6)).cells.sum() == 0


@pytest.mark.parametrize(("at", "seen"), [(0.5, True), (0.0, False)])
def test_a_box_around_a_sensor_is_not_in_its_way(at, seen):
    """As for rays: what is convex and holds the sensor is not seen."""
    with Boxes(MAST, ([0.5, 0.5, 0.5], [at, 0, 0])) as boxes:
        boxes.world.add_sensor("lidar", "a", position=[0.0 if seen else -0.6, 0, 0], **LIDAR)
        grid = boxes.eval(SEEN.format(z=0.0))
        assert bool(grid.at(2.0, 0.05)) == seen


@pytest.mark.slow
def test_bunches_of_cells_change_nothing(kitchen, monkeypatch):
    query = "SELECT obj FROM kitchen WHERE isSensor(this) AS sensorgrid(0.24, 0.1);"
    whole = kitchen.eval(query)
    monkeypatch.setattr(forms, "_BATCH", 120)
    assert kitchen.eval(query) == whole
    assert whole


def test_fields_of_view_and_what_is_off():
    with Boxes(([0.3, 0.3, 0.3], [0, 0, 0])) as boxes:  # the host is in nobody's way
        add = boxes.world.add_sensor
        camera = add("depth_camera", "a", "c", width=40, height=20, fov=60, max_range=2.0)
        points = centres(boxes.eval(SEEN.format(z=0.25)), 0.25)
        x, y, z = points.T
        half = np.tan(np.radians(30))
        in_image = (x > 0) & (x <= 2) & (abs(z) <= half * x) & (abs(y) <= 2 * half * x)
        grid = boxes.eval(SEEN.format(z=0.25))
        assert np.array_equal(grid.cells.ravel(), in_image)
        add("planar_laser", "a", "l", min_angle=-90, max_angle=45, resolution=1, max_range=2.5)
        angle, r = np.degrees(np.arctan2(y, x)), np.linalg.norm(points, axis=1)
        # flat: it sees heights that are at most half a cell off, 0.25 is not
        assert np.array_equal(boxes.eval(SEEN.format(z=0.25)), grid)
        points = centres(grid, 0.04)
        r = np.linalg.norm(points, axis=1)
        flat = boxes.eval(
            "SELECT obj FROM sim WHERE id(this) == 'l' AS sensorgrid(0.04, 0.1, [[-3, -3], [3, 3]]);"
        )
        in_fan = (r <= 2.5) & (angle >= -90) & (angle <= 45 + 1e-9)
        assert np.array_equal(flat.cells.ravel(), in_fan)
        add("range_finder", "a", "r", max_range=1.0)
        line = boxes.eval(
            "SELECT obj FROM sim WHERE id(this) == 'r' AS sensorgrid(0, 0.1, [[-3, -3.05], [3, 2.95]]);"
        )
        assert np.argwhere(line).tolist() == [[i, 30] for i in range(30, 40)]
        both = boxes.eval(SEEN.format(z=0.04))
        assert both.cells.max() >= 2
        camera.power(False)
        assert not boxes.eval("SELECT obj FROM sim WHERE id(this) == 'c' AS sensorgrid(0.25, 0.1);")
        add("contact_sensor", "a", "touch")
        assert not boxes.eval(
            "SELECT obj FROM sim WHERE id(this) == 'touch' AS sensorgrid(0.25, 0.1);"
        )


def test_the_kitchens_sensors_see_what_pybullets_rays_reach(kitchen):
    query = "SELECT obj FROM kitchen WHERE id(this) == 'fridge_webcam' AS sensorgrid(0.5, 0.04);"
    grid = kitchen.eval(query)
    world = kitchen.call_variable("kitchen")
    sensor, client = world["fridge_webcam"], world._simulator.client
    start, points = np.array(sensor.position), centres(grid, 0.5)
    local = (points - start) @ Rotation.from_quat(np.roll(sensor.orientation, -1)).as_matrix()
    half = np.tan(np.radians(sensor.spec.settings["fov"] / 2))
    wide = half * sensor.spec.settings["width"] / sensor.spec.settings["height"]
    x, y, z = local.T
    seen = (x > 0) & (x <= sensor.spec.max_range) & (abs(y) <= wide * x) & (abs(z) <= half * x)
    inside = np.flatnonzero(seen)
    # the fridge, which the camera sits on, is a ball behind it
    hits = pybullet.rayTestBatch([start] * len(inside), points[inside], physicsClientId=client)
    seen[inside] = [hit[0] < 0 for hit in hits]
    assert 200 < seen.sum() < len(inside)
    # Bullet's hulls are 1 mm larger
    assert (grid.cells.ravel() != seen).mean() < 0.005


def test_sensors_of_a_recorded_tick_and_of_groups():
    with Boxes(MAST, others=[BALL | {"position": [1, 0, 0]}]) as boxes:
        boxes.world.add_sensor("lidar", "a", "one", **LIDAR)
        boxes.world.add_sensor("lidar", "a", "two", **LIDAR | {"max_range": 1.0})
        query = (
            "SELECT obj FROM {} WHERE isSensor(this) {} AS sensorgrid(0, 0.1, [[-3, -3], [3, 3]]);"
        )
        before = boxes.eval(query.format("sim", ""))
        assert set(np.unique(before)) == {0, 1, 2}
        time = boxes.world.time
        boxes.world.step(240)
        assert boxes.eval(query.format("sim", "")) != before
        assert boxes.eval(query.format(f"sim{{{time}}}", "")) == before
        groups = boxes.eval(query.format(f"sim{{{time}}}", "GROUP BY id"))
        assert set(groups) == {"one", "two"}
        assert np.array_equal(groups["one"].cells + groups["two"].cells, before.cells)


# -- sums over a plane ----------------------------------------------------------------------------


def test_masses_over_planes(kitchen):
    world = kitchen.call_variable("kitchen")
    for axes, (i, j) in {"XY": (0, 1), "xz": (0, 2), "YZ": (1, 2)}.items():
        grid = kitchen.eval(
            f"SELECT obj, mass FROM kitchen AS plane('{axes}', [-5,-5], [100,100,0.1]);"
        )
        expected = np.zeros((100, 100))
        for entity in world:
            place = entity.position
            expected[int((place[i] + 5) / 0.1), int((place[j] + 5) / 0.1)] += entity.mass
        assert np.asarray(grid) == pytest.approx(expected)
        assert (grid.axes, grid.shape, grid.origin) == (axes.upper(), (100, 100), (-5.0, -5.0))
        assert expected.sum() > 10


def test_as_in_the_ode_dialect(kitchen):
    """There the position is asked for by the form, and a fourth argument blurs."""
    plain = kitchen.eval("SELECT obj, mass FROM kitchen AS plane('XY', [-5,-5], [100,100,0.1]);")
    named = kitchen.eval("SELECT mass FROM kitchen AS plane('XY', [-5,-5], [100,100,0.1]);")
    assert named == plain
    blurred = kitchen.eval("SELECT mass FROM kitchen AS plane('XY', [-5,-5], [100,100,0.1], 3);")
    assert blurred.cells.sum() == pytest.approx(plain.cells.sum())
    kernel = np.array([[max(0, 4 - abs(i) - abs(j)) for j in range(-2, 3)] for i in range(-2, 3)])
    padded, expected = np.pad(plain.cells, 2), np.zeros((100, 100))
    for i in range(5):
        for j in range(5):
            expected += padded[i : i + 100, j : j + 100] * kernel[i, j] / kernel.sum()
    assert blurred.cells == pytest.approx(expected)


@pytest.mark.parametrize(
    ("place", "cell"),
    [([0, 0], [0, 0]), ([1 - TINY, 0], [0, 0]), ([1, 0], [1, 0]), ([2.999, 1.999], [2, 1])]
    + [([3, 0], None), ([-TINY, 0], None), ([0, 2], None)],
)
def test_cells_have_their_lower_edges(place, cell):
    with Boxes(([0.1, 0.1, 0.1], [*place, 7])) as boxes:
        grid = boxes.eval("SELECT obj, [2, 3.5], 1 FROM sim AS plane('XY', [0, 0], [3, 2, 1]);")
        assert np.argwhere(grid).tolist() == ([cell] if cell else [])
        assert grid.cells.sum() == (6.5 if cell else 0)


def test_sums_of_groups(kitchen):
    groups = kitchen.eval(
        "SELECT obj, mass FROM kitchen GROUP BY type AS plane('XY', [-5,-5], [10,10,1]);"
    )
    whole = kitchen.eval("SELECT obj, mass FROM kitchen AS plane('XY', [-5,-5], [10,10,1]);")
    assert sum(grid.cells for grid in groups.values()) == pytest.approx(whole.cells)


# -- errors ---------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("form", "message"),
    [
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
    ],
)
def test_what_cannot_be(kitchen, form, message):
    with pytest.raises(SelectScriptError, match=message.replace(" | ", r" \| ")) as caught:
        kitchen.eval(f"{ALL} {form};")
    assert caught.value.span is not None


@pytest.mark.parametrize(
    ("query", "message"),
    [
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
        (
            "SELECT obj, id FROM kitchen AS plane('XY', [0, 0], [9, 9, 1]);",
            "column 'id' cannot be summed",
        ),
        (
            "SELECT mass(a.this) FROM a=kitchen, b=kitchen AS plane('XY', [0, 0], [9, 9, 1]);",
            "no column holds an entity",
        ),
    ],
)
def test_what_is_not_there(kitchen, query, message):
    with pytest.raises(ArgumentError, match=message):
        kitchen.eval(query)


def test_nothing_is_empty_where_bounds_are_given(kitchen):
    empty = kitchen.eval("SELECT obj FROM kitchen WHERE False AS map(0.2, 0.1, [[0, 0], [1, 2]]);")
    assert (empty.shape, bool(empty)) == ((10, 20), False)


def test_the_box_of_an_entity_as_bounds(kitchen):
    table = "table = SELECT obj FROM kitchen WHERE id(this) == 'table' AS value;"
    grid = kitchen.eval(f"{table} SELECT obj FROM kitchen AS map(0.9, 0.05, bounds=aabb(table));")
    low, high = kitchen.call_variable("kitchen")["table"].aabb
    assert grid.origin == tuple(low[:2])
    assert grid.shape == tuple(np.ceil((np.array(high) - low)[:2] / 0.05).astype(int))


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


def test_help_tells_the_forms():
    with ssduck.Interpreter() as ss:
        told = ss.help("AS")
    for form in forms.GRIDS:
        assert form.usage in told
    assert "AS occupancygrid | map(z_pos, grid_size, bounds=None)" in told


# -- records, evaluators, other ways in -----------------------------------------------------------


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
