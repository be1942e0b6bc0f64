"""A WHY in a page: the tree of its parts, drawn at the tick that decides."""

import pytest

import ssduck

pytest.importorskip("websockets", reason="the extra view is not installed")
from ssduck.view.scans import Scan
from tests.support.viewing import IN_CHROMIUM, asked, opened

CUP = "kitchen.cup_905a"
WHY = f"WHY always(z({CUP}) < 1.2 AND on(kitchen.table, {CUP}));"


@pytest.fixture(scope="module")
def ss(record):
    with ssduck.open(record) as ss:
        yield ss


@pytest.fixture(scope="module")
def heights(ss):
    """The times of the ticks, and the heights of the cup."""
    rows = ss.sql("SELECT time, z FROM entities_history WHERE name = 'cup_905a' ORDER BY tick")
    return rows.fetchall()


def test_a_why_is_a_tree_that_is_drawn_at_the_tick_that_decides(served, ss, heights):
    (first, _), (last, _) = heights[0], heights[-1]
    time, z = max(heights, key=lambda row: row[1])
    with opened(served.url) as socket:
        answer = asked(socket, type="ask", text=WHY, at=first, anew=True)
        assert (answer["time"], answer["decided"]) == (last, time)
        assert answer["columns"] == ["why", "margin"]
        texts, margins = zip(*answer["rows"], strict=True)
        assert [text[0] for text in texts] == ["✗"] * 4
        assert margins[:2] == (None, None)  # on has none
        assert margins[2:] == (pytest.approx(1.2 - z), None)
        assert f"at {time:g} s" in texts[1]
        ids = {entity.name: entity.id for entity in ss.worlds[0]}
        cup, table = [ids["cup_905a"], -1], [ids["table"], -1]
        assert answer["marks"] == [[], [], [cup], [table, cup]]
        assert answer["all"] == sorted([cup, table])
        assert (answer["lines"], answer["boxes"]) == ([], [])
        parts = answer["drawing"]["parts"]
        assert [part["depth"] for part in parts] == [0, 1, 2, 2]
        start, end = parts[2]["points"]
        assert (start[2], end[2]) == pytest.approx((z, 1.2))
        assert start[:2] == end[:2]
        # Asked again elsewhere, it is of that tick: nothing has failed, or is decided.
        again = asked(socket, type="ask", text=WHY, at=first)
        assert (again["time"], again["rows"][0][0][0]) == (first, "?")


def test_what_looks_back_is_of_the_tick_that_is_seen(served, heights):
    """A replay sees no later ticks."""
    middle, _ = heights[5]
    with opened(served.url) as socket:
        text = f"WHY historically(z({CUP}) < 1.2);"
        answer = asked(socket, type="ask", text=text, at=middle, anew=True)
        assert answer["time"] == middle
        assert answer["rows"][0][0].startswith("✓")
        answer = asked(socket, type="ask", text=f"WHY z({CUP}) < 1.2;", at=middle, anew=True)
        assert (answer["decided"], answer["drawing"]["parts"][0]["time"]) == (None, None)


def test_a_scan_finds_where_a_condition_flips_though_margins_change_always(ss, heights):
    scan = Scan(ss, ss.worlds[0], f"WHY z({CUP}) < 1.2;", "selectscript")
    while scan.advance(0.05):
        pass
    holds = [z < 1.2 for _, z in heights]
    flips = [time for (time, _), a, b in zip(heights[1:], holds, holds[1:], strict=False) if a != b]
    assert [start for start, _, _ in scan.progress["runs"][1:]] == flips
    assert len(flips) == 2


@pytest.mark.long
@IN_CHROMIUM
def test_the_page_goes_to_the_tick_that_decides_and_draws_its_parts(served, heights, browser):
    times = [time for time, _ in heights]
    time, _ = max(heights, key=lambda row: row[1])
    decisive = max(index for index, each in enumerate(times) if each == time)
    page = browser.open(served.url)
    page.wait("window.__ss && __ss.ready && __ss.ticks")
    page.ask(WHY)
    page.wait(f"__ss.index === {decisive} && Math.abs(__ss.time - {time}) < 1e-9")
    page.wait("__ss.drawings > 0")
    texts = page.value(
        "[...document.querySelectorAll('#result .why td:first-child')]"
        ".map(td => [parseInt(td.style.paddingLeft), td.textContent[0]])"
    )
    assert [mark for _, mark in texts] == ["✗"] * 4
    assert [left for left, _ in texts] == sorted(left for left, _ in texts)
    answers = page.value("__ss.answers")
    page.value(f"__ss.seek({decisive - 3}); 0")
    page.wait(f"__ss.answers > {answers}")  # it is asked at that tick, and is not decided yet
    assert page.value("document.querySelector('#result td').textContent[0]") == "?"
    assert page.errors() == []
    page.close()
