"""The page in a real browser: scene, queries, highlights, errors, and clicks."""

import base64
import io
import json
from functools import partial

import numpy as np
import pandas as pd
import pytest
from PIL import Image

pytest.importorskip("websockets", reason="the extra view is not installed")
from ssduck.view.answers import MAX_ROWS
from tests.support.cases import sampled
from tests.support.viewing import IN_CHROMIUM
from tools import draw_page

pytestmark = [pytest.mark.slow, IN_CHROMIUM]


@pytest.fixture(scope="module")
def page(ss, browser):
    served = ss.view()
    page = browser.open(served.url)
    page.wait("window.__ss && __ss.ready")
    yield page
    served.close()
    page.wait("!__ss.connected")
    page.close()


def cells(page):
    """Returns the texts of the table, row by row."""
    return page.value(
        "[...document.querySelectorAll('#result tbody tr')].map(row => "
        "[...row.cells].map(cell => cell.textContent))"
    )


def test_a_query_fills_the_table_and_lights_up(page):
    before = page.picture()
    page.ask("SELECT id(this) FROM kitchen WHERE id(this) == 'table';")
    assert cells(page) == [["table"]]
    x, y = map(int, page.value("__ss.placeOf('table')"))
    red, green, blue = page.picture()[y, x].astype(int)
    assert tuple(before[y, x]) != (red, green, blue)
    assert red > blue + 60  # orange


def test_everything_comes_from_the_server_itself(page):
    """The browser of the tests has no network, either."""
    loaded = page.value(
        "performance.getEntriesByType('resource').map(each => new URL(each.name).origin)"
    )
    assert loaded
    assert set(loaded) == {page.value("location.origin")}


def test_a_click_on_a_head_sorts_the_table(page):
    page.ask("SELECT id, z FROM kitchen WHERE z > 0.5;")
    heights = []
    for _ in range(2):
        page.value("document.querySelectorAll('#result th')[1].click(); 0")
        heights.append([float(row[1]) for row in cells(page)])
    assert len(heights[0]) > 3
    assert heights[0] == sorted(heights[0])
    assert heights[1] == heights[0][::-1]


@pytest.mark.parametrize(
    ("type", "texts"),
    [
        ("hugeint", [f"-{10**37}", "0", f"{2**63 - 2}", f"{2**63 - 1}"]),  # no two are one double
        ("double", ["-inf", "-2.5", "0", "1234567.89", "inf", "nan"]),  # DuckDB's order
    ],
)
def test_numbers_are_exact_and_sorted_as_numbers(page, type, texts):
    values = ", ".join(f"('{text}')" for text in texts[1::2] + texts[::2])
    page.value("document.querySelector('[data-language=sql]').click(); 0")
    page.ask(f"SELECT v::{type} AS v, '' AS e FROM (VALUES (NULL), {values}) AS t(v)")
    page.value("document.querySelector('[data-language=selectscript]').click(); 0")
    for order in (texts, texts[::-1]):
        page.value("document.querySelector('#result th').click(); 0")
        assert cells(page) == [[text, ""] for text in (*order, "NULL")]
    styles = page.value(
        "[...document.querySelectorAll('#result td:first-child')]"
        ".map(cell => [getComputedStyle(cell).textAlign, Number(getComputedStyle(cell).opacity)])"
    )
    assert {align for align, _ in styles} == {"right"}
    assert [opacity < 1 for _, opacity in styles] == [False] * len(texts) + [True]


# Keeps the files that the page makes, instead of a browser's folder of downloads.
CAUGHT = """
window.files = [];
URL.createObjectURL = (blob) => (files.push({ blob }), "blob:caught");
HTMLAnchorElement.prototype.click = function () { files.at(-1).name = this.download; };
0
"""
CONTENT = """
files[0].blob.arrayBuffer().then(
  (content) => btoa([...new Uint8Array(content)].map((byte) => String.fromCharCode(byte)).join("")))
"""


def downloaded(page, format):
    """Returns the name and the content of the file that a button of the page makes."""
    page.value(CAUGHT)
    page.value(f"document.querySelector('[data-format={format}]').click(); 0")
    name = page.wait("window.files[0]?.name")
    return name, io.BytesIO(base64.b64decode(page.value(CONTENT)))


@sampled(
    ("format", "read"),
    [
        ("csv", partial(pd.read_csv, converters={"z": float})),
        ("json", json.load),
        ("parquet", pd.read_parquet),
    ],
    every=2,
)
def test_a_result_is_downloaded(ss, page, format, read):
    program = "SELECT id, z, isRobot(this) FROM kitchen WHERE z > 0.5;"
    page.ask(program)
    name, content = downloaded(page, format)
    rows = read(content)
    rows = rows if format == "json" else rows.to_dict("records")
    assert name == f"result.{format}"
    expected = ss.eval(program)
    assert len(expected) > 3
    assert [list(row.items()) for row in rows] == [list(row.items()) for row in expected]


def test_a_long_result_is_elided_and_downloaded_whole(page):
    count = MAX_ROWS + 234
    page.value("document.querySelector('[data-language=sql]').click(); 0")
    page.ask(f"SELECT range AS number FROM range({count})")
    page.value("document.querySelector('[data-language=selectscript]').click(); 0")
    assert len(cells(page)) == MAX_ROWS
    text = page.value("document.getElementById('count').textContent")
    assert text.startswith(f"{count} rows ({MAX_ROWS} shown)")
    _, content = downloaded(page, "csv")
    assert pd.read_csv(content)["number"].tolist() == list(range(count))


def test_a_wrong_name_has_the_nearest_right_one(page):
    page.ask("SELECT id(this) FROM kitchen WHERE '😀😀😀' != '' AND this == kitchen.frigde;")
    text = page.value("document.getElementById('error').textContent")
    assert "no entity 'frigde'" in text
    assert "^^^^^^" in text
    page.value("document.querySelector('#error button').click()")
    page.wait("document.querySelector('#result td')?.textContent === 'fridge'")


def test_a_click_shows_the_entity(page):
    page.click(*page.value("__ss.placeOf('table')"))
    assert page.wait("__ss.picked") == "table"
    assert "plate" in page.value("document.getElementById('entity').textContent")


@sampled(
    ("program", "has_picture"),
    [
        ("SELECT this FROM kitchen WHERE id(this) == 'table' AS occupancygrid(0.4, 0.1);", True),
        ("SELECT this FROM kitchen WHERE id(this) == 'table' AS points(0.05);", True),
        ("SELECT id FROM kitchen WHERE id == 'table';", False),
    ],
    every=2,
)
def test_grids_and_clouds_are_drawn_in_the_scene(page, program, has_picture):
    page.ask(program)
    assert page.value("__ss.error") is None
    assert page.value("__ss.drawings") == has_picture
    assert page.value("document.querySelectorAll('#result img').length") == has_picture


@pytest.mark.long
def test_a_lost_connection_comes_back(ss, page):
    cup = ss["kitchen"]["cup_905a"]
    # It comes back after a second, which may pass before the next look.
    page.value(
        "window.wasLost = false; const sign = document.getElementById('lost');"
        "new MutationObserver(() => (window.wasLost ||= !sign.hidden))"
        ".observe(sign, { attributes: true }); __ss.drop(); 0"
    )
    page.wait("wasLost && __ss.connected && __ss.ready")
    assert page.value("document.getElementById('lost').hidden")
    x, y, z = map(float, cup.position)
    cup.move([x, y, z + 0.1])
    ss["kitchen"].tick()
    page.wait(f"Math.abs(__ss.poseOf('cup_905a')[2] - {z + 0.1}) < 1e-5")
    page.ask("2 + 2;")
    assert cells(page) == [["4"]]


@sampled("size", [(1280, 720), (800, 600)], every=2)
def test_nothing_overlaps(page, size):
    page.resize(*size)
    page.ask("SELECT id, z FROM kitchen WHERE z > 0.5;")
    page.click(*page.value("__ss.placeOf('table')"))
    page.wait("__ss.picked === 'table'")
    boxes = page.value(
        "['#stage', 'aside header', '#editor', '#summary', '#result', '#entity', '#controls', "
        "'#slider', '#moment'].map(name => { const box = document.querySelector(name)"
        ".getBoundingClientRect(); return [name, box.left, box.top, box.right, box.bottom]; })"
    )
    shown = [
        (name, *map(round, box)) for name, *box in boxes if box[2] > box[0] and box[3] > box[1]
    ]
    assert {"#stage", "#result", "#entity", "#slider"} <= {name for name, *_ in shown}
    for place, (name, left, top, right, bottom) in enumerate(shown):
        assert 0 <= left < right <= size[0], name
        assert 0 <= top < bottom <= size[1], name
        for other, *box in shown[place + 1 :]:
            is_apart = box[0] >= right or box[2] <= left or box[1] >= bottom or box[3] <= top
            assert is_apart, (name, other)


@pytest.mark.long
@pytest.mark.parametrize("draw", [draw_page.draw, draw_page.draw_why])
def test_the_manuals_pictures_are_up_to_date(draw, tmp_path):
    path = draw(tmp_path)
    drawn, stored = (
        np.asarray(Image.open(each).convert("RGB")).astype(int)
        for each in (path, draw_page.IMAGES / path.name)
    )
    assert stored.shape == drawn.shape
    # Fonts, and the time that the answer took, are not the same everywhere.
    assert (np.abs(stored - drawn).max(axis=2) > 48).mean() < 0.05
