"""The page in a real browser: scene, queries, highlights, errors, time and clicks."""

import numpy as np
import pytest
from PIL import Image

import ssduck

pytest.importorskip("websockets", reason="the extra view is not installed")
from ssduck.view.view import view_record
from tools import draw_page
from tools.browser import Browser, chromium

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(chromium() is None, reason="there is no Chromium"),
]


@pytest.fixture(scope="module")
def browser(tmp_path_factory):
    browser = Browser(tmp_path_factory.mktemp("browser"))
    yield browser
    browser.close()


@pytest.fixture(scope="module")
def ss():
    with ssduck.load("kitchen") as ss:
        yield ss


@pytest.fixture(scope="module")
def page(ss, browser):
    served = ss.view()
    page = browser.open(served.url)
    page.wait("window.__ss && __ss.ready")
    yield page
    served.close()
    page.wait("!__ss.connected")
    page.close()


def test_a_query_fills_the_table_and_lights_up(page):
    before = page.picture()
    page.ask("SELECT id(this) FROM kitchen WHERE id(this) == 'table';")
    assert page.value("document.querySelector('#result td').textContent") == "table"
    x, y = map(int, page.value("__ss.placeOf('table')"))
    red, green, blue = page.picture()[y, x].astype(int)
    assert tuple(before[y, x]) != (red, green, blue)
    assert red > blue + 60  # orange


def test_a_wrong_name_has_the_nearest_right_one(page):
    page.ask("SELECT id(this) FROM kitchen WHERE this == kitchen.frigde;")
    text = page.value("document.getElementById('error').textContent")
    assert "no entity 'frigde'" in text
    assert "^^^^^^" in text
    page.value("document.querySelector('#error button').click()")
    page.wait("document.querySelector('#result td')?.textContent === 'fridge'")


def test_a_click_shows_the_entity(page):
    page.click(*page.value("__ss.placeOf('table')"))
    assert page.wait("__ss.picked") == "table"
    assert "plate" in page.value("document.getElementById('entity').textContent")


def test_what_moves_in_the_world_moves_on_all_pages(ss, page, browser):
    cup = ss["kitchen"]["cup_905a"]
    second = browser.open(page.value("location.href"))
    second.wait("window.__ss && __ss.ready")
    x, y, z = map(float, cup.position)
    cup.move([x, y, z + 0.5])
    ss["kitchen"].tick()
    for each in (page, second):
        each.wait(f"Math.abs(__ss.poseOf('cup_905a')[2] - {z + 0.5}) < 1e-5")
    second.close()


def test_a_page_that_is_loaded_again_works(page):
    page.value("__ss.ready = false; location.reload(); 0")
    page.wait("window.__ss && __ss.ready")
    page.ask("1 + 1;")
    assert page.value("document.querySelector('#result td').textContent") == "2"


def test_the_slider_goes_through_a_record(tmp_path, browser):
    with ssduck.load("kitchen") as ss:
        kitchen = ss["kitchen"]
        ss.record_to(tmp_path / "run")
        name = "cup_905a"
        heights = []
        for step in range(4):
            x, y, z = kitchen[name].position
            kitchen[name].move([x, y, z + 0.2 * step])
            kitchen.step()
            heights.append(float(kitchen[name].position[2]))
    with view_record(tmp_path / "run") as served:
        page = browser.open(served.url)
        page.wait("window.__ss && __ss.ready")
        times = page.value("Number(document.getElementById('slider').max)") + 1
        page.value(f"__ss.seek({times - 1}); 0")
        page.wait(f"Math.abs(__ss.poseOf('{name}')[2] - {heights[-1]}) < 1e-4")
        page.ask(f"SELECT z(this) FROM kitchen WHERE id(this) == '{name}' AS value;")
        shown = float(page.value("document.querySelector('#result td').textContent"))
        assert np.isclose(shown, heights[-1], atol=1e-4)
        page.close()


def test_the_manuals_picture_is_up_to_date(tmp_path):
    drawn, stored = (
        np.asarray(Image.open(folder / "view.png").convert("RGB")).astype(int)
        for folder in (draw_page.draw(tmp_path).parent, draw_page.IMAGES)
    )
    assert stored.shape == drawn.shape
    # Fonts, and the time that the answer took, are not the same everywhere.
    assert (np.abs(stored - drawn).max(axis=2) > 48).mean() < 0.05
