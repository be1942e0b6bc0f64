"""The page as users press it: reloads, and several clicks in a row."""

import json

import pytest

import ssduck

pytest.importorskip("websockets", reason="the extra view is not installed")
from tools.browser import chromium

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(chromium() is None, reason="there is no Chromium"),
]
# Some seconds of work, and no row until the end.
LONG = "SELECT count(*) FROM range(60000) a, range(60000) b WHERE a.range + b.range = 7"


@pytest.fixture(scope="module")
def ss():
    with ssduck.load("kitchen") as ss:
        yield ss


@pytest.fixture(scope="module")
def url(ss):
    with ss.view() as served:
        yield served.url


@pytest.fixture
def page(url, browser):
    page = browser.open(url)
    page.wait("window.__ss && __ss.ready")
    yield page
    page.close()


def first_cell(page):
    return page.value("document.querySelector('#result td')?.textContent")


def test_a_page_is_loaded_again_in_the_middle_of_a_query(ss, page):
    answers = page.value("__ss.answers")
    page.value("document.querySelector('[data-language=sql]').click(); 0")
    page.value(f"__ss.type({json.dumps(LONG)}); __ss.run(); 0")
    assert page.value("__ss.answers") == answers
    page.value("__ss.ready = false; location.reload(); 0")
    page.wait("window.__ss && __ss.ready && document.readyState === 'complete'")
    cup = ss["kitchen"]["cup_905a"]
    x, y, z = map(float, cup.position)
    cup.move([x, y, z + 0.2])
    ss["kitchen"].tick()
    page.wait(f"Math.abs(__ss.poseOf('cup_905a')[2] - {z + 0.2}) < 1e-5")
    cup.move([x, y, z])
    ss["kitchen"].tick()
    page.ask("40 + 2;")
    assert first_cell(page) == "42"
    assert not page.errors()


def test_the_last_of_several_questions_is_answered(page):
    for number in range(6):
        page.value(f"__ss.type('{number} + 100;'); document.getElementById('run').click(); 0")
    page.wait("document.querySelector('#result td')?.textContent === '105'")
    page.ask("1 + 1;")  # nothing that was asked before comes later
    assert first_cell(page) == "2"
    assert not page.errors()


def test_the_last_of_several_entities_is_shown(page):
    places = [page.value(f"__ss.placeOf('{name}')") for name in ("table", "roomba_625x", "table")]
    for place in (*places, places[1]):
        page.click(*place)
    page.wait("__ss.picked === 'roomba_625x'")
    page.ask("1 + 1;")
    assert page.value("document.querySelector('#entity h2').firstChild.textContent") == (
        "roomba_625x"
    )
