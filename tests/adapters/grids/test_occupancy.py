"""Which cells are occupied, and the class of grids."""

import pickle
import subprocess
import sys
import time
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from scipy.spatial import ConvexHull
from scipy.spatial.transform import Rotation

import ssduck
from ssduck.adapters.grid_values import OccupancyGrid, PlaneGrid, SensorGrid, VoxelGrid
from ssduck.errors import ArgumentError, LimitError
from ssduck.limits import UsageMeter
from tests.support.cases import sampled
from tests.support.grids import ALL, BALL, TINY, Boxes, centres

ROOT = Path(__file__).resolve().parents[3]


# -- what is occupied ----------------------------------------------------------------------------


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


@pytest.mark.slow
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


@pytest.mark.slow
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


@pytest.mark.slow
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


# -- the class -----------------------------------------------------------------------------------


def test_it_is_an_array(grid):
    assert np.asarray(grid).dtype == bool
    assert np.asarray(grid, dtype=float).sum() == 2.0
    assert grid.astype(float).dtype == float
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
    assert len(pictures) == 10
    for name, drawn in pictures.items():
        path = ROOT / "docs" / "images" / f"{name}.png"
        assert f"(../images/{name}.png)" in page
        assert path.stat().st_size < 100_000
        stored = pixels(path)
        assert stored.shape == drawn.shape, f"{name}: run tools/draw_forms.py"
        # Grids are exact; renderers and the fonts of axes are not the same everywhere.
        other = (np.abs(stored - drawn).max(axis=2) > 32).mean()
        most = 0.05 if name.startswith("forms-") else 0.005
        assert other <= most, f"{name}: run tools/draw_forms.py"


@pytest.mark.slow
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


LARGE = [
    "SELECT obj FROM kitchen WHERE isSensor(this) AS sensorgrid(0.24, 0.002);",
    "SELECT obj FROM kitchen AS voxelgrid(0.01);",
]


@pytest.mark.slow
@sampled("program", LARGE, every=2)
def test_a_large_grid_stops_at_the_next_check(program, monkeypatch):
    """A step of the work between two checks is small: the time is up at the fifth check."""
    checks = []

    def check_time(meter):
        checks.append(time.process_time())
        if len(checks) == 5:
            raise LimitError("the time is up")

    with ssduck.load("kitchen", limits=ssduck.Limits(seconds=600.0), recording=None) as ss:
        ss.eval("SELECT obj FROM kitchen AS voxelgrid(1);")  # shapes are built
        monkeypatch.setattr(UsageMeter, "check_time", check_time)
        with pytest.raises(LimitError, match="the time is up"):
            ss.eval(program)
    assert len(checks) == 5
    assert max(after - before for before, after in pairwise(checks)) < 5.0
