"""The time line of the page in a real browser: records, and the past of live worlds."""

import json

import numpy as np
import pytest

import ssduck

pytest.importorskip("websockets", reason="the extra view is not installed")
from ssduck.view.view import view_record, view_scene
from tests.support.viewing import IN_CHROMIUM

pytestmark = [pytest.mark.long, IN_CHROMIUM]
CUP = "cup_905a"
# The cup is lifted from the table at this tick of those that are recorded.
LIFTED = 12


@pytest.fixture(scope="module")
def record(tmp_path_factory):
    path = tmp_path_factory.mktemp("record") / "run"
    with ssduck.load("kitchen") as ss:
        kitchen = ss["kitchen"]
        ss.run(0.2)  # it comes to rest
        with ss.record_to(path):
            for step in range(20):
                kitchen.step()
                if step >= LIFTED:
                    x, y, z = kitchen[CUP].position
                    kitchen[CUP].move([x, y, z + 0.05])
    return path


@pytest.fixture(scope="module")
def page(record, browser):
    with view_record(record) as served:
        page = browser.open(served.url)
        page.wait("window.__ss && __ss.ready && __ss.ticks")
        yield page
        page.close()


@pytest.fixture(scope="module")
def heights(record):
    """The heights of the cup at the recorded ticks."""
    with ssduck.open(record) as ss:
        ticks = ss.sql(
            "SELECT z FROM kitchen.entities_history WHERE name = ? ORDER BY tick", [CUP]
        ).fetchall()
    return [z for (z,) in ticks]


def test_a_recorded_kitchen_is_not_grey(page):
    picture = page.picture()[:400, :800].astype(int)
    is_colourful = np.ptp(picture, axis=2) > 100  # the colours of what has none are paler
    assert is_colourful.mean() > 0.02


def test_the_tick_has_the_number_of_the_tables(page, record):
    """From the beginning on, when the server shows it, and when the page does."""
    with ssduck.open(record) as ss:
        numbers = [n for (n,) in ss.sql("SELECT tick FROM kitchen.ticks_history").fetchall()]
    assert numbers[0] > 1
    for index in (0, len(numbers) - 1):
        page.value(f"__ss.seek({index}); 0")
        label = f"tick {numbers[index]} ({index + 1} of {len(numbers)})"
        page.wait(f"document.getElementById('time').textContent.endsWith({json.dumps(label)})")


def test_scrubbing_asks_the_server_for_no_poses(page, heights):
    page.value("__ss.seek(0); 0")
    page.wait("__ss.local > 0")
    updates, local = page.value("[__ss.updates, __ss.local]")
    for index in range(0, len(heights), 2):
        z = page.value(f"__ss.seek({index}), __ss.poseOf('{CUP}')[2]")
        assert np.isclose(z, heights[index], atol=1e-5)  # at once
    assert page.value("__ss.updates") == updates
    assert page.value("__ss.local") > local


def test_the_query_is_asked_again_as_the_slider_moves(page, heights):
    page.value("__ss.seek(0); 0")
    page.ask(f"SELECT z(this) FROM kitchen WHERE id(this) == '{CUP}' AS value;")
    page.value(f"__ss.seek({len(heights) - 1}); 0")
    page.wait(
        f"Math.abs(Number(document.querySelector('#result td').textContent) - {heights[-1]}) < 1e-4"
    )


def test_the_answers_changes_are_found_and_jumped_to(page, record):
    query = f"on(kitchen.table, kitchen.{CUP});"
    with ssduck.open(record) as ss:
        changes = [time for time, _ in ss.eval(f"changes(on(kitchen.table, kitchen.{CUP}));")][1:]
    assert len(changes) == 1
    page.value("__ss.seek(0); 0")
    scans = page.value("__ss.scans")
    page.ask(query)
    page.wait(f"__ss.scans > {scans}")
    assert page.value("__ss.changes") == pytest.approx(changes)
    assert page.value("__ss.lanes")[0][0] == "answer"
    page.value("document.getElementById('next').click(); 0")
    page.wait(f"Math.abs(__ss.time - {changes[0]}) < 1e-9")
    page.wait("document.querySelector('#result td').textContent === 'false'")


def test_what_holds_when_is_a_bar_above_the_slider(page, record):
    query = f"holds(on(kitchen.table, kitchen.{CUP}));"
    with ssduck.open(record) as ss:
        spans = ss.eval(query)
    page.value("__ss.seek(2); 0")
    page.ask(query)  # the bars are those of the whole record
    ((label, bars),) = page.value("__ss.lanes")
    assert label == "holds"
    assert bars == [pytest.approx(span) for span in spans]
    row = page.value("document.querySelector('.lane canvas').getBoundingClientRect().bottom")
    assert row <= page.value("document.getElementById('slider').getBoundingClientRect().top")


def test_the_past_of_a_column_is_plotted(page):
    page.value("__ss.seek(0); 0")
    page.click(*page.value(f"__ss.placeOf('{CUP}')"))
    page.wait(f"__ss.picked === '{CUP}'")
    page.wait("!!document.querySelector('#entity .plot .curve')")
    before = page.value("document.querySelector('#entity .plot .curve').getAttribute('d')")
    page.value(
        "const select = document.querySelector('.plots select'); select.value = 'x'; "
        "select.dispatchEvent(new Event('change')); 0"
    )
    page.wait(
        "document.querySelector('#entity .plot .curve').getAttribute('d') !== " + repr(before)
    )


def test_a_live_world_has_its_past_and_the_firings_of_its_triggers(browser):
    with ssduck.load("kitchen") as ss, ss.view() as served:
        page = browser.open(served.url)
        page.wait("window.__ss && __ss.ready")
        kitchen = ss["kitchen"]
        program = f"z(kitchen.{CUP}) > 1.3;"
        ss.add_trigger("lifted", program, 0, lambda _: None, when="rising")
        ss.run(0.1)
        low = float(kitchen[CUP].position[2])
        x, y, z = kitchen[CUP].position
        kitchen[CUP].move([x, y, z + 0.5])
        ss.run(0.02)
        count = len(ss.past("kitchen").ticks)
        page.wait(f"__ss.ticks >= {count} && __ss.index === __ss.ticks - 1")
        ((name, bars),) = page.wait("__ss.lanes.length && __ss.lanes")
        assert name == "lifted"
        assert len(bars) == 1
        page.value("__ss.seek(5); 0")
        page.wait(f"Math.abs(__ss.poseOf('{CUP}')[2] - {low}) < 0.01")
        page.ask(f"z(kitchen.{CUP});")
        shown = float(page.value("document.querySelector('#result td').textContent"))
        assert np.isclose(shown, low, atol=0.01)
        page.value("document.getElementById('live').click(); 0")
        high = float(kitchen[CUP].position[2])
        page.wait(f"Math.abs(__ss.poseOf('{CUP}')[2] - {high}) < 1e-4")
        page.close()


def test_a_scene_plays_and_stops(browser):
    def load():
        from ssduck.simulators.scenes import find_scene

        world = ssduck.World.load(find_scene("kitchen"))
        world.name = "kitchen"
        return world

    with view_scene(load) as served:
        page = browser.open(served.url)
        page.wait("window.__ss && __ss.ready")
        page.value("document.getElementById('play').click(); 0")
        page.wait("__ss.time > 0.05")
        page.value("document.getElementById('play').click(); 0")
        page.wait("document.querySelector('#play path').getAttribute('d').startsWith('M4')")
        time = page.value("__ss.time")
        page.value("document.getElementById('reset').click(); 0")
        page.wait("__ss.time === 0")
        assert time > 0.05
        page.close()
