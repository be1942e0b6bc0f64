"""Pictures with axes: that they show what is where it is, to the pixel."""

import io
import pickle
import sys

import networkx as nx
import numpy as np
import pytest
from PIL import Image

import ssduck
from ssduck.adapters.charts import (
    COLOURS,
    MAX_ENTRIES,
    chart,
    draw_points,
    draw_triangles,
    legend,
    ticks,
)
from ssduck.adapters.grid_values import OccupancyGrid, PlaneGrid, SensorGrid, VoxelGrid
from ssduck.adapters.point_cloud import PointCloud
from ssduck.errors import ArgumentError, NumberError, UnsupportedError

# Two boxes and a plate; y leads away from the viewer, and the wall hides the hidden one.
SCENE = """\
name = "room"
[[body]]
name = "wall"
box = [2.0, 0.2, 1.0]
position = [0.0, 0.0, 0.5]
fixed = true
[[body]]
name = "hidden"
box = [0.2, 0.2, 0.2]
position = [-0.2, 0.6, 0.1]
fixed = true
[[body]]
name = "seen"
box = [0.4, 0.2, 0.2]
position = [0.0, -0.8, 0.1]
fixed = true
"""


@pytest.fixture(scope="module")
def room(tmp_path_factory):
    path = tmp_path_factory.mktemp("room") / "room.toml"
    path.write_text(SCENE)
    with ssduck.load(path, recording=None) as ss:
        yield ss


def pixels(picture):
    return np.asarray(picture.convert("RGB")).astype(int)


# -- ticks and frames ----------------------------------------------------------------------------

TICKS = [
    ((0, 1), [0, 0.2, 0.4, 0.6, 0.8, 1]),
    ((-1.7, 2.45), [-1, 0, 1, 2]),
    ((0, 0), [0]),
    ((-5e-4, 5e-4), [-4e-4, -2e-4, 0, 2e-4, 4e-4]),
    ((1e6, 1e6 + 3), [1e6, 1e6 + 0.5, 1e6 + 1, 1e6 + 1.5, 1e6 + 2, 1e6 + 2.5, 1e6 + 3]),
    ((0.1, 0.3), [0.1, 0.15, 0.2, 0.25, 0.3]),
]


@pytest.mark.parametrize(("bounds", "expected"), TICKS)
def test_ticks_are_round_and_within(bounds, expected):
    assert ticks(*bounds) == pytest.approx(expected)


def test_ticks_of_counts_are_whole():
    assert ticks(0, 2, 8, whole=True) == [0, 1, 2]
    assert ticks(0, 90, 5, whole=True) == [0, 20, 40, 60, 80]


def test_a_legend_counts_what_it_leaves_out():
    assert legend(["a", "b"]) == [(COLOURS[0], "a"), (COLOURS[1], "b")]
    many = legend([str(n) for n in range(50)])
    assert len(many) == MAX_ENTRIES + 1
    assert many[-1][1] == f"and {50 - MAX_ENTRIES} more"
    assert len(set(COLOURS)) >= MAX_ENTRIES


def test_the_area_of_a_chart_is_unchanged():
    area = Image.fromarray(np.random.default_rng(0).integers(0, 255, (90, 120, 3), np.uint8))
    picture = pixels(chart(area, ((0, 0), (4, 3)), ("x [m]", "y [m]")))
    start = picture.shape[1] - 120 - 10 - 1
    assert (picture[10:100, start : start + 120] == pixels(area)).all()


# -- grids ---------------------------------------------------------------------------------------


def framed_area(picture, size):
    """The area of a chart within its frame."""
    dark = (pixels(picture) == (40, 44, 52)).all(axis=2)
    row = np.nonzero(dark.sum(axis=1) >= size[0])[0][0]
    column = np.nonzero(dark.sum(axis=0) >= size[1])[0][0]
    return pixels(picture)[row + 1 : row + 1 + size[1], column + 1 : column + 1 + size[0]]


def test_a_chart_of_a_grid_has_its_cells_in_their_place():
    cells = np.zeros((4, 3), dtype=bool)
    cells[0, 2] = cells[3, 0] = True
    grid = OccupancyGrid(cells, (0.0, 0.0), 0.5)
    area = framed_area(grid.chart(400), (400, 300))
    dark = area.sum(axis=2) < 300
    assert dark[:100, :100].all()  # y is up
    assert dark[200:, 300:].all()
    assert dark.sum() == 2 * 100 * 100


GRIDS = [
    OccupancyGrid(np.eye(3, dtype=bool), (0.0, 0.0), 0.5),
    OccupancyGrid(np.zeros((3, 900), dtype=bool), (-1e3, 1e3), 0.01),
    SensorGrid(np.array([[0, 1], [2, 3]]), (0.0, 0.0), 0.5),
    SensorGrid(np.zeros((2, 2), dtype=int), (0.0, 0.0), 0.5),
    PlaneGrid(np.array([[0.5, 1e9]]), (0.0, 0.0), 0.5, "YZ"),
    PlaneGrid(np.array([[-1.0, np.nan]]), (0.0, 0.0), 0.5, "XZ"),
    VoxelGrid(np.ones((2, 2, 2), dtype=bool), (0.0, 0.0, 0.0), 0.1),
]


@pytest.mark.filterwarnings("ignore:invalid value encountered in cast")
@pytest.mark.parametrize("grid", GRIDS, ids=repr)
def test_all_grids_are_drawn(grid):
    picture = Image.open(io.BytesIO(grid._repr_png_()))
    assert max(picture.size) >= 400
    assert picture.size == grid.chart().size
    assert grid.plot().get_xlabel() == f"{grid.axes[0].lower()} [m]"


def test_a_chart_of_many_cells_is_reduced():
    cells = np.zeros((6001, 10), dtype=bool)
    cells[3000:] = True
    picture = OccupancyGrid(cells, (0.0, 0.0), 0.01).chart()
    assert 1500 < picture.width < 2300
    row = pixels(picture)[11]
    assert (row.sum(axis=1) < 300).sum() == pytest.approx(750, abs=30)


def test_the_size_of_a_chart_is_a_number():
    with pytest.raises(NumberError, match="chart: size"):
        GRIDS[0].chart(0)


# -- points and meshes ---------------------------------------------------------------------------


def test_points_have_the_colours_of_their_owners():
    points = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]])
    picture = draw_points(points, np.array([0, 1, 2, 3]), ["a", "b", "c", "d"])
    places = []
    for colour in COLOURS[:4]:
        rows, columns = np.nonzero((pixels(picture) == colour).all(axis=2))
        inner = columns < picture.width - 60  # not in the legend
        places.append((columns[inner].mean(), rows[inner].mean()))
    (ox, oy), (ax, ay), (bx, by), (cx, cy) = places
    assert ax > ox  # x leads to the right and to the viewer
    assert ay > oy
    assert bx > ox  # y leads to the right and away
    assert by < oy
    assert cy < oy  # z is up
    assert cx == pytest.approx(ox, abs=1)


def triangle(x, depth):
    """A triangle at a distance from the viewer, whose direction the picture fixes."""
    toward = np.array([np.cos(-np.pi / 3), np.sin(-np.pi / 3), 0.0]) * depth
    right = np.array([np.sin(np.pi / 3), np.cos(np.pi / 3), 0.0])
    return [toward + right * (x + dx) + [0, 0, z] for dx, z in ((0, 0), (1, 0), (0.5, 1))]


@pytest.mark.parametrize("order", [(0, 1), (1, 0)])
def test_the_nearer_triangle_hides_the_other_one(order):
    pair = np.array([triangle(0.0, 0.0), triangle(0.0, 5.0)])[list(order)]
    names = np.array(["far", "near"])[list(order)]
    picture = pixels(draw_triangles(pair, np.array([0, 1]), ["", ""]))
    # The far one is higher in the picture, because the viewer looks down; the near one is whole.
    near = int(np.nonzero(names == "near")[0][0])
    shade = np.array(COLOURS[near]) / max(COLOURS[near])
    hues = picture / np.maximum(picture.max(axis=2, keepdims=True), 1)
    drawn = (np.abs(hues - shade).max(axis=2) < 0.03) & (picture.min(axis=2) < 200)
    assert drawn.sum() > 100


@pytest.mark.slow
def test_a_mesh_is_hidden_by_what_stands_before_it(room):
    picture = room.eval("SELECT obj FROM room AS mesh;").image()
    area = pixels(picture)[:, :480]
    counts = {}
    for index, name in enumerate(("wall", "hidden", "seen")):
        hue = np.array(COLOURS[index]) / max(COLOURS[index])
        hues = area / np.maximum(area.max(axis=2, keepdims=True), 1)
        counts[name] = int((np.abs(hues - hue).max(axis=2) < 0.03).sum())
    assert counts["wall"] > 10_000
    assert counts["seen"] > 1000
    assert counts["hidden"] == 0


@pytest.mark.slow
def test_points_and_meshes_in_notebooks(room):
    for form in ("points(0.05)", "mesh"):
        value = room.eval(f"SELECT obj FROM room AS {form};")
        shown = Image.open(io.BytesIO(value._repr_png_()))
        assert shown.size == value.image().size
        assert len(shown.getcolors(100_000)) > 3
    empty = PointCloud(np.zeros((0, 3)), np.zeros((0, 3)), np.zeros(0, dtype=np.intp), ())
    assert empty._repr_png_().startswith(b"\x89PNG")
    nothing = room.eval("SELECT obj FROM room WHERE z(this) > 9 AS mesh;")
    assert nothing._repr_png_().startswith(b"\x89PNG")
    flat = draw_points(np.ones((5, 3)), np.zeros(5, dtype=np.intp), ["one"])
    assert flat.size[0] > 0


@pytest.mark.slow
def test_links_are_drawn_by_their_names(room):
    for form in ("mesh", "points(0.05)", "graph"):
        value = room.eval(f"SELECT this FROM links(room) AS {form};")
        assert value._repr_png_().startswith(b"\x89PNG")
    assert value.nodes[next(iter(value.nodes))]["kind"] == "link"


def test_points_are_plotted(room, monkeypatch):
    cloud = room.eval("SELECT obj FROM room AS points(0.05);")
    axes = cloud.plot()
    assert [text.get_text() for text in axes.get_legend().get_texts()] == ["wall", "hidden", "seen"]
    assert axes.get_zlabel() == "z [m]"
    assert cloud.plot(axes) is axes
    for name in [name for name in sys.modules if name.startswith("matplotlib")]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    with pytest.raises(
        UnsupportedError, match=r"matplotlib is not installed; pip install 'ssduck\[p"
    ):
        cloud.plot()


# -- graphs --------------------------------------------------------------------------------------

PAIRS = "FROM a=room, b=room WHERE a.this != b.this"


@pytest.mark.parametrize(
    ("form", "base"), [("graph", nx.DiGraph), ("graph(multi=True)", nx.MultiDiGraph)]
)
def test_a_graph_is_a_picture_and_stays_networkx(room, form, base):
    graph = room.eval(f"SELECT distance(a.this, b.this) {PAIRS} AS {form};")
    assert isinstance(graph, base)
    assert nx.utils.graphs_equal(pickle.loads(pickle.dumps(graph)), graph)  # noqa: S301
    assert nx.is_strongly_connected(graph)
    copy = graph.copy()
    copy.add_edge("wall", "a node of mine")
    for each in (graph, copy, graph.subgraph(["wall"]), type(graph)(), graph.reverse()):
        assert each._repr_png_().startswith(b"\x89PNG")


def test_nodes_are_where_the_entities_are(room):
    graph = room.eval(f"SELECT distance(a.this, b.this) {PAIRS} AS graph;")
    picture = pixels(graph.image("XY"))
    blue = (picture == COLOURS[0]).all(axis=2)
    blue[:, -80:] = False  # the legend
    from scipy.ndimage import center_of_mass, label

    labels, count = label(blue)
    sizes = np.bincount(labels.ravel())[1:]
    discs = [n + 1 for n in range(count) if sizes[n] > 40]
    assert len(discs) == 3
    found = sorted(center_of_mass(blue, labels, discs))
    places = sorted(
        (tuple(e.position[:2]) for e in room.call_variable("room")), key=lambda p: -p[1]
    )
    (x0, y0), (row0, column0) = places[0], found[0]
    scale = (found[2][0] - row0) / (y0 - places[2][1])  # pixels for a metre
    assert scale > 100
    for (x, y), (row, column) in zip(places, found, strict=True):
        assert row - row0 == pytest.approx((y0 - y) * scale, abs=1.5)
        assert column - column0 == pytest.approx((x - x0) * scale, abs=1.5)


def test_the_plane_of_a_graph(room):
    graph = room.eval(f"SELECT distance(a.this, b.this) {PAIRS} AS graph;")
    # y has the largest extent, and the heights differ more than x.
    assert (pixels(graph.image()) == pixels(graph.image("YZ"))).all()
    assert graph.image("XZ").size != graph.image("XY").size
    with pytest.raises(ArgumentError, match="plane: 'XX' is not one of XY, XZ, YZ"):
        graph.image("XX")
