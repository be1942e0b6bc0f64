"""The page as users press it: reloads, clicks in a row, two pages, the keyboard, a stopped server."""

import json
import time

import pytest

import ssduck

pytest.importorskip("websockets", reason="the extra view is not installed")
from tests.support.viewing import IN_CHROMIUM

pytestmark = [pytest.mark.slow, IN_CHROMIUM]
# Some seconds of work, and no row until the end.
LONG = "SELECT count(*) FROM range(60000) a, range(60000) b WHERE a.range + b.range = 7"


@pytest.fixture(scope="module")
def url(ss):
    with ss.view() as served:
        yield served.url


@pytest.fixture(scope="module")
def page(url, browser):
    page = browser.open(url)
    page.wait("window.__ss && __ss.ready")
    yield page
    page.close()


def first_cell(page):
    return page.value("document.querySelector('#result td')?.textContent")


def press(page, key, number):
    """Presses a key, as a user does."""
    for kind in ("rawKeyDown", "keyUp"):
        page.call(
            "Input.dispatchKeyEvent", type=kind, key=key, code=key, windowsVirtualKeyCode=number
        )


@pytest.mark.long
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


@pytest.mark.long
def test_the_last_of_several_entities_is_shown(page):
    places = [page.value(f"__ss.placeOf('{name}')") for name in ("table", "roomba_625x", "table")]
    for place in (*places, places[1]):
        page.click(*place)
    page.wait("__ss.picked === 'roomba_625x'")
    page.ask("1 + 1;")
    assert page.value("document.querySelector('#entity h2').firstChild.textContent") == (
        "roomba_625x"
    )


@pytest.mark.long
def test_two_pages_ask_for_themselves(page, url, browser):
    other = browser.open(url)
    other.wait("window.__ss && __ss.ready")
    page.ask("SELECT id FROM kitchen WHERE id == 'table';")
    other.ask("SELECT id FROM kitchen WHERE id == 'roomba_625x';")
    assert [first_cell(each) for each in (page, other)] == ["table", "roomba_625x"]
    for each, name in ((other, "roomba_625x"), (page, "table")):
        each.call("Page.bringToFront")  # a page behind another one is not drawn
        x, y = map(int, each.value(f"__ss.placeOf('{name}')"))
        red, _, blue = each.picture()[y, x].astype(int)
        assert red > blue + 60  # it stands out on this page
    other.close()
    page.ask("20 + 1;")
    assert first_cell(page) == "21"


def test_a_row_is_reached_and_a_head_pressed_by_the_keyboard(page):
    page.ask("SELECT id, z FROM kitchen WHERE z > 0.5;")
    page.value("document.getElementById('clear').focus(); 0")
    for _ in range(2):
        press(page, "Tab", 9)
    for is_up in (True, False):
        press(page, "Enter", 13)
        mark = page.value("document.activeElement.textContent")
        assert mark == f"z {'▴' if is_up else '▾'}"
    press(page, "Tab", 9)
    press(page, "Enter", 13)
    name = first_cell(page)
    page.wait(f"__ss.picked === {json.dumps(name)}")


def test_a_narrow_page_has_the_scene_above_the_query(page):
    page.resize(420, 800)
    page.ask("SELECT id, z FROM kitchen WHERE z > 0.5;")
    stage, aside, footer = (
        page.value(f"(b => [b.left, b.top, b.right, b.bottom])({found}.getBoundingClientRect())")
        for found in (f"document.querySelector('{name}')" for name in ("#stage", "aside", "footer"))
    )
    assert stage[3] <= aside[1] < aside[3] <= footer[1] < footer[3] <= 800
    assert all(box[2] <= 420 for box in (stage, aside, footer))
    assert min(stage[3] - stage[1], aside[3] - aside[1]) > 200
    page.resize(1280, 800)


@pytest.mark.long
def test_a_page_whose_server_has_stopped_says_so(browser):
    with ssduck.load("kitchen") as ss:
        served = ss.view()
        page = browser.open(served.url)
        page.wait("window.__ss && __ss.ready")
        served.close()
        page.wait("!document.getElementById('lost').hidden")
        page.value("__ss.type('1 + 1;'); __ss.run(); 0")
        page.wait("document.getElementById('error').textContent === 'there is no connection'")
        page.close()


# What is typed, whether Enter asks at once, and the text then.
ENTERED = [
    ("z(kitchen.fridge", "fridge", "z(kitchen.fridge"),  # the name stands there: an error, at once
    ("SELECT id FROM kitchen AS list", "list", "SELECT id FROM kitchen AS list"),
    ("SELECT id FROM kitchen WHERE isRobot", "isRobot", "SELECT id FROM kitchen WHERE isRobot"),
]


def typed(page, text):
    """Types a text as a user does, and waits for the completions."""
    page.call("Page.bringToFront")  # one behind another page shows none
    page.value("__ss.type(''); document.querySelector('.cm-content').focus(); 0")
    page.call("Input.insertText", text=text[:-1])
    page.call("Input.insertText", text=text[-1])
    page.wait("!!document.querySelector('.cm-tooltip-autocomplete [aria-selected]')")


@pytest.mark.parametrize(("text", "chosen", "expected"), ENTERED)
def test_enter_asks_where_completion_offers_what_stands_there(page, text, chosen, expected):
    page.value("document.querySelector('[data-language=selectscript]').click(); 0")
    answers = page.value("__ss.answers")
    typed(page, text)
    option = (
        "document.querySelector('.cm-tooltip-autocomplete [aria-selected] .cm-completionLabel')"
    )
    assert page.value(f"{option}.textContent") == chosen
    time.sleep(0.1)  # a menu that just came takes no keys
    press(page, "Enter", 13)
    page.wait(f"__ss.answers > {answers}")
    assert page.value("document.querySelector('.cm-content').textContent") == expected
    assert not page.value("document.querySelector('.cm-tooltip-autocomplete')")
    assert not page.errors()


def test_enter_takes_a_completion_that_is_longer(page):
    answers = page.value("__ss.answers")
    typed(page, "SELECT z(kitchen.frid")
    time.sleep(0.1)
    press(page, "Enter", 13)
    page.wait("document.querySelector('.cm-content').textContent === 'SELECT z(kitchen.fridge'")
    assert page.value("__ss.answers") == answers


def test_several_statements_show_that_the_result_is_the_last_ones(page):
    page.ask("1 + 1; x = 3; 40 + 2;")
    assert first_cell(page) == "42"
    note = page.value("document.getElementById('error').textContent")
    assert "the result of the last of 3 statements" in note
    page.ask("x = 3; x + 1;")  # assignments have no result
    assert page.value("document.getElementById('error').hidden")


@pytest.mark.long
def test_names_of_links_stand_out(page):
    """Those of one link, not of its whole robot."""
    orange = []
    for name in ("pin_c671", "barrett_4918.arm3", "barrett_4918"):
        page.ask(f"SELECT '{name}' FROM [1];")
        picture = page.picture()[:560, :800].astype(int)
        orange.append(((picture[..., 0] - picture[..., 2] > 120) & (picture[..., 0] > 200)).sum())
    assert orange[0] + 20 < orange[1] < orange[2] - 20
