"""Transparent shapes in the page and in pictures: what is behind them is seen through them."""

import numpy as np
import pytest
from PIL import Image

import ssduck

pytest.importorskip("websockets", reason="the extra view is not installed")
from tests.support.viewing import IN_CHROMIUM

pytestmark = [pytest.mark.slow, IN_CHROMIUM]

URDF = """<robot name="{name}"><link name="base">
<visual><geometry><box size="0.05 {size} {size}"/></geometry>
<material name="{name}"><color rgba="{colour}"/></material></visual>
<collision><geometry><box size="0.05 {size} {size}"/></geometry></collision>
</link></robot>"""
BODY = """
[[body]]
name = "{name}"
kind = "kinbody"
urdf = "{name}.urdf"
position = [{x}, 0, 1]
orientation = [1, 0, 0, 0]
fixed = true
"""
CAMERA = """
name = "glass"
[camera]
eye = [4, 0, 1]
target = [0, 0, 1]
fov = 50
"""


def scene(folder, alpha):
    """Writes the scene of a blue pane in front of a red wall."""
    bodies = [("wall", 0, 2, "1 0 0 1"), ("pane", 1, 1, f"0 0 1 {alpha}")]
    for name, _, size, colour in bodies:
        text = URDF.format(name=name, size=size, colour=colour)
        (folder / f"{name}.urdf").write_text(text)
    text = CAMERA + "".join(BODY.format(name=name, x=x) for name, x, _, _ in bodies)
    (folder / "scene.toml").write_text(text)
    return folder / "scene.toml"


def check(pixel, alpha):
    red, _, blue = map(int, pixel)
    if alpha == 1:
        assert red < 30
        assert blue > 100
    else:
        assert min(red, blue) > 60


@pytest.mark.long
@pytest.mark.parametrize("alpha", [0.4, 1])
def test_what_is_behind_a_pane_is_seen_through_it(browser, tmp_path, alpha):
    with ssduck.load(scene(tmp_path, alpha)) as ss, ss.view() as served:
        page = browser.open(served.url)
        page.wait("window.__ss && __ss.ready")
        page.value("new Promise(done => requestAnimationFrame(() => requestAnimationFrame(done)))")
        x, y = map(int, page.value("__ss.placeOf('pane')"))
        picture = page.picture()
        check(picture[y, x], alpha)
        x, y = map(int, page.value("__ss.placeOf('wall')"))
        red, _, blue = map(int, picture[y, x])
        assert red > 100
        assert blue < 40
        page.ask("SELECT id FROM glass WHERE id == 'pane';")
        x, y = map(int, page.value("__ss.placeOf('pane')"))
        red, _, blue = map(int, page.picture()[y, x])
        assert red > blue + 60  # it stands out
        page.close()


@pytest.mark.parametrize("alpha", [0.4, 1])
def test_what_is_behind_a_pane_is_in_pictures_too(tmp_path, alpha):
    pytest.importorskip("moderngl", reason="the extra render is not installed")
    from ssduck.render.rendering import Film, render

    render(scene(tmp_path, alpha), tmp_path / "glass.png", Film(size=(200, 200)))
    check(np.array(Image.open(tmp_path / "glass.png"))[100, 100, :3], alpha)
