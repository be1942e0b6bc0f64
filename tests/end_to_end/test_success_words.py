"""The words of other predicate libraries: each condition of the page runs on the page's scene."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

import ssduck

pytest.importorskip("mujoco")

PAGE = Path(__file__).parents[2].joinpath("docs/reference/success-words.md").read_text("utf-8")
# The rows of tables that have four columns: the word, its definition, the condition, the difference.
ROWS = re.findall(r"^\| (?!word|-)([^|]*) \|[^|]*\| `([^|]*)` \|[^|]*\|$", PAGE, re.MULTILINE)


@pytest.fixture(scope="module")
def lab():
    (code,) = re.findall(r"```python\n(.*?)```", PAGE, re.DOTALL)
    names = {}
    exec(compile(code, "success-words.md", "exec"), names)  # noqa: S102
    with names["ss"] as ss:
        yield ss


def test_all_rows_are_read():
    tables = re.findall(r"^\| (?!word)\S", PAGE, re.MULTILINE)
    assert len(ROWS) == len(tables) > 40


@pytest.mark.parametrize("condition", dict.fromkeys(condition for _, condition in ROWS))
def test_a_condition_has_a_value(lab, condition):
    rewards = [row for row in ROWS if "reward" in row[0]]
    expected = float if condition in [text for _, text in rewards] else bool
    value = lab.eval(f"{condition};")
    assert isinstance(value, int | float) if expected is float else type(value) is bool


TRUE = [
    "on(lab.plate, lab.bowl)",
    "supports(lab.plate, lab.bowl) AND speed(lab.bowl) < 0.1",
    "heldFor(settled(lab.bowl)) >= 0.1",
    "upright(lab.bowl, 0.2)",
    "hasContact(lab.bowl, lab.plate)",
    "isClosed(lab.cabinet, 'slide')",
]


@pytest.mark.parametrize("condition", TRUE)
def test_what_holds_in_the_scene(lab, condition):
    assert condition in [text for _, text in ROWS]
    assert lab.eval(f"{condition};") is True


def test_the_bowl_is_on_the_plate_as_libero_means_it(lab):
    ((_, condition),) = [row for row in ROWS if row[0] == "`(On bowl plate)`"]
    assert lab.eval(f"{condition};") is True
    with pytest.raises(ssduck.SelectScriptError, match="bowll"):
        lab.eval(condition.replace("lab.bowl", "lab.bowll") + ";")
