"""Pairs of links are found at once in a world with sensors, which have no shapes."""

import pytest

import ssduck

SOURCES = (("links(kitchen)", "links(kitchen)"), ("kitchen", "links(kitchen)"))


@pytest.fixture(scope="module")
def ss():
    with ssduck.load("kitchen") as interpreter:
        assert len(interpreter.eval("SELECT id(this) FROM kitchen WHERE isSensor(this);")) > 1
        yield interpreter


@pytest.mark.slow
@pytest.mark.parametrize("condition", ["touching(a.this, b.this)", "on(a.this, b.this)"])
@pytest.mark.parametrize(("first", "second"), SOURCES)
def test_at_once_is_one_by_one(ss, first, second, condition):
    selected = f"SELECT str(a.this), str(b.this) FROM a={first}, b={second} WHERE {condition}"
    at_once, one_by_one = (
        ss.eval(f"{selected}{more} AS list;") for more in ("", " AND z(a.this) > -1e9")
    )
    pairs = [sorted(zip(found[::2], found[1::2], strict=True)) for found in (at_once, one_by_one)]
    assert pairs[0]
    assert pairs[0] == pairs[1]
