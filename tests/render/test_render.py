"""Pictures and films: what is drawn where, against projections computed by hand."""

import math
import warnings
from dataclasses import replace

import numpy as np
import pytest
from PIL import Image

import ssduck
from ssduck.errors import ArgumentError, ProgramWarning, SelectScriptError, UnknownNameError
from ssduck.logic.why import Why
from ssduck.render import Film, filmed, render
from ssduck.render.overlays import with_parts
from ssduck.simulators.scenes import Camera
from tests.support.command_line import answer
from tests.support.opengl import skip_without_opengl

skip_without_opengl(allow_module_level=True)

SCENE = """\
floor = true

[[body]]
name = "red"
box = [0.4, 0.4, 0.4]
position = [0, 0, 0.2]
fixed = true
colour = [0.9, 0.1, 0.1]

[[body]]
name = "green"
sphere = 0.2
position = [1.2, 0, 0.2]
fixed = true
colour = [0.1, 0.8, 0.1]

[[body]]
name = "faller"
box = [0.2, 0.2, 0.2]
position = [-1, 0, 3]
colour = [0.1, 0.1, 0.9]
"""
WIDTH, HEIGHT = 320, 240
VIEW = Camera((4.0, -6.0, 4.0), (0.0, 0.0, 1.4), 50.0)
SIZE = (WIDTH, HEIGHT)


@pytest.fixture(scope="module")
def scene(tmp_path_factory):
    path = tmp_path_factory.mktemp("scene") / "desk.toml"
    path.write_text(SCENE)
    return path


@pytest.fixture(scope="module")
def record(scene):
    """A record of the falling box, with a tick every 20 ms."""
    path = scene.parent / "run"
    with ssduck.load(scene) as ss:
        recording = ss.record_to(path)
        ss.worlds[0].run(1.0, every=5)
        recording.close()
    return path


def pixel(point, camera=VIEW):
    """Returns the column and row of a point of the world, by the pinhole's formulas."""
    eye = np.array(camera.eye)
    forward = np.array(camera.target) - eye
    forward /= np.linalg.norm(forward)
    right = np.cross(forward, [0, 0, 1])
    right /= np.linalg.norm(right)
    away = np.array(point) - eye
    depth = away @ forward
    scale = HEIGHT / 2 / math.tan(math.radians(camera.fov) / 2) / depth
    return (
        round(WIDTH / 2 + away @ right * scale),
        round(HEIGHT / 2 - away @ np.cross(right, forward) * scale),
    )


def drawn(path):
    return np.asarray(Image.open(path).convert("RGB")).astype(int)


def at(picture, point):
    column, row = pixel(point)
    return picture[row, column]


@pytest.fixture(scope="module")
def picture(scene):
    path = render(scene, scene.parent / "still.png", Film(size=SIZE, camera=VIEW))
    return drawn(path)


@pytest.mark.parametrize(
    ("point", "channel"), [((0, 0, 0.4), 0), ((1.2, 0, 0.4), 1), ((-1, 0, 3.1), 2)]
)
def test_bodies_are_where_a_pinhole_camera_sees_them(picture, point, channel):
    colour = at(picture, point)
    assert colour[channel] > 1.5 * np.delete(colour, channel).max()


def test_a_shadow_is_darker_than_the_ground_beside(picture):
    # The light comes from (0.35, -0.45, 0.82): the shadow of a point falls opposite.
    shaded = np.array([0, 0, 0.3]) - np.array([0.35, -0.45, 0.82]) * 0.3 / 0.82 + [-0.12, 0.15, 0]
    lit = [0.6, -0.8, 0]
    assert at(picture, [*shaded[:2], 0]).sum() < 0.8 * at(picture, lit).sum()


def test_edges_are_smooth(picture):
    """Beside the pixels of the red box are some that are partly of it."""
    column, row = pixel((0, 0, 0.4))
    around = picture[row - 30 : row + 30, column - 30 : column + 30]
    reddish = (around[..., 0] - around[..., 1]) / 255
    assert (reddish > 0.4).sum() > 60
    assert ((reddish > 0.05) & (reddish < 0.25)).sum() > 4


@pytest.mark.slow
def test_highlighted_entities_stand_out(scene, picture):
    path = scene.parent / "marked.png"
    query = "SELECT id(this) FROM desk WHERE z(this) > 1;"
    render(scene, path, Film(size=SIZE, camera=VIEW, highlight=query))
    marked = drawn(path)
    falling, red = at(marked, (-1, 0, 3.1)), at(marked, (0, 0, 0.4))
    assert falling[0] > 1.8 * falling[2]  # orange, and no longer blue
    assert np.ptp(red) < 0.5 * np.ptp(at(picture, (0, 0, 0.4)))  # paler than before
    sql = "SELECT name FROM entities WHERE z > 1"
    render(scene, path, Film(size=SIZE, camera=VIEW, highlight=sql, language="sql"))
    assert (drawn(path) == marked).all()


@pytest.mark.slow
@pytest.mark.parametrize(
    ("query", "language", "told"),
    [
        ("isKinbody(desk.red);", "selectscript", r"answers True, which has no entity .* of 'desk'"),
        ("SELECT z FROM desk;", "selectscript", r"answers \[\{'z': .*, which has no entity"),
        ("SELECT z FROM entities LIMIT 1", "sql", r"answers \[.*, which has no entity"),
        ("SELECT id FROM desk WHERE z(this) > 99;", "selectscript", r"> 99;' has no rows"),
    ],
)
def test_an_answer_without_entities_is_told_of(scene, query, language, told):
    film = Film(size=(64, 48), camera=VIEW, highlight=query, language=language)
    with pytest.warns(ProgramWarning, match=f"highlight: nothing stands out.*{told}") as caught:
        render(scene, scene.parent / "unmarked.png", film)
    assert len(caught) == 1


@pytest.mark.slow
def test_a_film_in_which_something_stands_out_sometimes_is_not_told_of(scene):
    query = "SELECT id(this) FROM desk WHERE z(this) > 1 AND getTime() > 0.1;"
    film = Film(span=(0.0, 0.3), fps=10, size=(64, 48), camera=VIEW, highlight=query)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        render(scene, scene.parent / "sometimes.gif", film)


HOLDS, FAILS = (26, 127, 55), (207, 34, 46)


def is_near(colour, other):
    """Checks where colours are about another one; what is highlighted has more green than blue."""
    difference = np.subtract(colour, other)
    is_alike = np.abs(difference).sum(axis=-1) < 90
    return is_alike & (np.abs(difference[..., 1] - difference[..., 2]) < 25)


def is_drawn(picture, point, colour):
    """Checks whether a colour is where a point is seen, or in a pixel beside."""
    column, row = pixel(point)
    return is_near(picture[row - 1 : row + 2, column - 1 : column + 2], colour).any()


@pytest.mark.slow
@pytest.mark.parametrize(("limit", "colour"), [(0.5, FAILS), (2, HOLDS)])
def test_of_a_why_nearest_points_are_drawn_with_the_margin(scene, limit, colour):
    """The cube and the sphere are 0.8 m apart, along x."""
    why = f"WHY near(desk.red, desk.green, {limit}) AND isKinbody(desk.red);"
    path = scene.parent / "why.png"
    marked = drawn(render(scene, path, Film(size=SIZE, camera=VIEW, highlight=why)))
    for x in (0.2, 0.6):
        assert is_drawn(marked, (x, 0, 0.2), colour)
    assert not is_drawn(marked, (-0.1, 0, 0.2), colour)
    column, row = pixel((0.6, 0, 0.2))
    label = marked[row - 4 : row + 5, column + 6 : column + 60]
    more = label[..., np.argmax(colour)] - label[..., np.argmin(colour)]
    assert (more > 40).sum() > 20  # the letters
    assert (label.min(axis=-1) > 240).sum() > 40  # are on white


@pytest.mark.slow
def test_of_a_why_a_record_shows_the_tick_that_decides(record, tmp_path):
    """The box is highest at first."""
    why = "WHY always(z(desk.faller) < 2.5);"
    film = Film(size=SIZE, camera=VIEW, highlight=why)
    marked = drawn(render(record, tmp_path / "decides.png", film))
    for z in (3.0, 2.7, 2.5):
        assert is_drawn(marked, (-1, 0, z), FAILS)
    now = Film(span=(1.0, 1.0), size=SIZE, camera=VIEW, highlight=why)
    assert not is_near(drawn(render(record, tmp_path / "now.png", now)), FAILS).any()
    assert (at(marked, (-1, 0, 3.05)) != at(drawn(tmp_path / "now.png"), (-1, 0, 3.05))).any()


def test_lines_that_leave_the_picture_are_cut_and_labels_are_apart():
    plain = np.full((HEIGHT, WIDTH, 3), 255, np.uint8)
    front, behind = (0.0, 0.0, 1.4), (9.0, -12.0, 6.0)
    one = Why("a", False, -1.0, points=(front, behind))
    between = np.array(front) + 0.3 * (np.array(behind) - front)
    for part in (one, replace(one, points=(behind, front))):
        cut = with_parts(plain, [part], VIEW).astype(int)
        for point in (front, between):
            assert is_drawn(cut, point, FAILS)
    hidden = replace(one, points=(behind, behind))
    assert (with_parts(plain, [hidden], VIEW) == plain).all()
    short = replace(one, points=(front, (0.1, 0.0, 1.4)))
    rows = [
        np.flatnonzero((with_parts(plain, [short] * count, VIEW) < 250).any(axis=(1, 2)))
        for count in (1, 2)
    ]
    assert np.ptp(rows[1]) > 1.7 * np.ptp(rows[0])


@pytest.mark.slow
def test_a_film_of_a_record_shows_each_time(record, tmp_path):
    film = Film(span=(0.0, 0.6), fps=10, size=SIZE, camera=VIEW)
    path = render(record, tmp_path / "film.gif", film)
    with Image.open(path) as gif:
        assert (gif.n_frames, gif.size) == (7, SIZE)
        durations = []
        for number in range(7):
            gif.seek(number)
            durations.append(gif.info["duration"])
            height = 3.0 - 0.5 * 9.81 * (number / 10) ** 2
            shown = np.asarray(gif.convert("RGB")).astype(int)
            rows = np.flatnonzero(is_body(shown).any(axis=1))
            _, row = pixel((-1, 0, height))
            assert rows.min() <= row <= rows.max()
    assert sum(durations) == 700


def is_body(picture):
    """Returns the pixels left of the others, where only the falling box is seen before the sky."""
    columns = np.arange(WIDTH) < pixel((-0.7, 0, 0.2))[0]
    background = np.median(picture[:, :20], axis=1)[:, None]
    return (np.abs(picture - background).sum(axis=2) > 60) & columns


@pytest.mark.slow
def test_speed_and_rate_give_the_number_of_pictures(record, tmp_path):
    seen = []
    for speed, fps, count in [(1.0, 10, 11), (2.0, 10, 6), (0.5, 10, 21), (1.0, 7, 8)]:
        film = Film(speed=speed, fps=fps, size=(32, 24), camera=VIEW)
        path = render(record, tmp_path / "film.gif", film, on_picture=lambda *n: seen.append(n))
        assert seen[-1] == (count, count)
        assert seen == [(n, count) for n in range(1, count + 1)]
        seen.clear()
        assert path.stat().st_size


@pytest.mark.slow
def test_an_mp4_has_the_size_and_the_pictures(record, tmp_path):
    imageio_ffmpeg = pytest.importorskip("imageio_ffmpeg")
    film = Film(fps=10, size=(64, 48), camera=VIEW)
    path = render(record, tmp_path / "film.mp4", film)
    frames, seconds = imageio_ffmpeg.count_frames_and_secs(str(path))
    assert frames == 11
    assert seconds == pytest.approx(1.1)
    assert path.read_bytes()[4:8] == b"ftyp"


@pytest.mark.slow
def test_a_world_in_use_is_drawn_as_it_is(scene, picture, tmp_path):
    with ssduck.load(scene) as ss:
        world = ss.worlds[0]
        for source in (ss, world):
            path = render(source, tmp_path / "now.png", Film(size=SIZE, camera=VIEW))
            assert (drawn(path) == picture).all()
        time = world.time
        with pytest.raises(ArgumentError, match="record it with record_to"):
            render(ss, tmp_path / "film.gif")
        assert world.time == time


@pytest.mark.slow
def test_a_world_in_use_is_filmed(scene, tmp_path):
    with ssduck.load(scene) as ss:
        world = ss.worlds[0]
        path = tmp_path / "film.gif"
        with filmed(world, path, Film(fps=10, size=SIZE, camera=VIEW)):
            world.run(0.3)
            assert not path.exists()
            world.run(0.2)
        with Image.open(path) as gif:
            assert gif.n_frames == 6
        before = path.read_bytes()
        with pytest.raises(ArgumentError), filmed(world, path, Film(size=SIZE)):
            world.step(-1)
        assert path.read_bytes() == before


@pytest.mark.slow
def test_bodies_that_come_and_go_are_drawn(scene, tmp_path):
    with ssduck.load(scene) as ss:
        world = ss.worlds[0]
        first = render(ss, tmp_path / "a.png", Film(size=SIZE, camera=VIEW))
        whole = drawn(first)
        world.remove("red")
        less = drawn(render(ss, tmp_path / "b.png", Film(size=SIZE, camera=VIEW)))
    assert at(whole, (0, 0, 0.4))[0] > 1.5 * at(whole, (0, 0, 0.4))[1]
    assert at(less, (0, 0, 0.4))[0] < 1.2 * at(less, (0, 0, 0.4))[1]


WRONG = [
    ({}, "film.avi", ArgumentError, r"film.avi does not end in .png, .gif or .mp4"),
    ({}, "nowhere/film.gif", ArgumentError, "there is no folder"),
    ({"size": (33, 24)}, "film.mp4", ArgumentError, "the size of an MP4 is even, not 33 x 24"),
    ({"fps": 60}, "film.gif", ArgumentError, "a GIF has at most 50 pictures a second"),
    ({"span": (3.0, 4.0)}, "film.gif", ArgumentError, "the record has ticks from 0 s to 1 s"),
    ({"span": (0.0, 1.0), "fps": 1e9}, "film.mp4", ArgumentError, "more than 100,000"),
    ({"highlight": "SELECT id(this) FROM desc;"}, "a.png", UnknownNameError, "desk"),
    ({"highlight": "SELECT FROM"}, "a.png", SelectScriptError, "FROM"),
    (
        {"highlight": "SELECT nam FROM entities", "language": "sql"},
        "a.png",
        SelectScriptError,
        "name",
    ),
]


@pytest.mark.slow
@pytest.mark.parametrize(("values", "name", "error", "message"), WRONG)
def test_errors_leave_no_file(record, tmp_path, values, name, error, message):
    with pytest.raises(error, match=message):
        render(record, tmp_path / name, Film(**values))
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"speed": 0}, "speed"),
        ({"fps": -1.0}, "pictures a second"),
        ({"fps": math.nan}, "pictures a second"),
        ({"size": (0, 10)}, "width"),
        ({"span": (2.0, 1.0)}, "the span ends before it starts: 2 s to 1 s"),
        ({"fps": 1e-300}, "fps is at least 0.001, not 1e-300"),
    ],
)
def test_a_film_checks_its_values(values, message):
    with pytest.raises(ArgumentError, match=message):
        Film(**values)


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"eye": (math.nan, 0.0, 0.0)}, "from one place to another"),
        ({"target": (0.0, math.inf, 0.0)}, "from one place to another"),
        ({"eye": (1.0, 1.0, 1.0), "target": [1.0, 1.0, 1.0]}, "from one place to another"),
        ({"fov": 0.0}, r"in \(0, 180\), not 0"),
        ({"fov": 180.0}, r"in \(0, 180\), not 180"),
        ({"fov": math.nan}, r"in \(0, 180\), not nan"),
    ],
)
def test_a_camera_checks_its_values(values, message):
    with pytest.raises(ArgumentError, match=message):
        Camera(**values)


@pytest.mark.parametrize("end", [1e6, 1e308])
def test_a_film_of_too_many_pictures(end):
    with pytest.raises(ArgumentError, match="pictures are more than 100,000; choose a shorter"):
        Film().times(-end, end)


@pytest.mark.slow
def test_ffmpeg_that_fails_leaves_the_file_as_it_was(record, tmp_path, monkeypatch):
    film = tmp_path / "film.mp4"
    film.write_text("old")
    monkeypatch.setattr("ssduck.render.rendering._QUALITY", "-crf 18 -f no_such_format -y")
    with pytest.raises(OSError, match=r"ffmpeg could not write the film: .*no_such_format"):
        render(record, film, Film(size=(64, 48), camera=VIEW, fps=2))
    assert film.read_text() == "old"
    assert [path.name for path in tmp_path.iterdir()] == ["film.mp4"]


@pytest.mark.slow
def test_the_command_draws(scene, record, tmp_path):
    options = ["--size", f"{WIDTH}x{HEIGHT}", "--eye", "4,-6,4", "--target", "0,0,1.4"]
    output = answer("render", str(scene), "-o", str(tmp_path / "a.png"), *options)
    assert output.strip() == str(tmp_path / "a.png")
    assert drawn(tmp_path / "a.png").shape == (HEIGHT, WIDTH, 3)
    answer(
        "render",
        str(record),
        "-o",
        str(tmp_path / "b.gif"),
        *options,
        "--fps",
        "5",
        "--to",
        "0.4",
        "--highlight",
        "SELECT name FROM entities",
        "--sql",
    )
    with Image.open(tmp_path / "b.gif") as gif:
        assert gif.n_frames == 3
