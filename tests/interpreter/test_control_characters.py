"""Names of strangers write no control characters to a terminal: errors and warnings escape them."""

import csv
import io
import json
import sys

import pytest

import ssduck
from ssduck.adapters.formats import FORMATS, print_value, text_of
from ssduck.adapters.result import TableView
from ssduck.errors import ArgumentError, ProgramWarning, UnknownNameError, warn
from tests.support.stage import Stage
from tests.support.warned import told

HOSTILE = "cup\x1b[2J\x9b31m\u202e\r"
ESCAPED = "cup\\u001b[2J\\u009b31m\\u202e\\u000d"


@pytest.mark.parametrize(
    "error",
    [
        ArgumentError(f"no {HOSTILE}"),
        UnknownNameError("no", suggestions=[HOSTILE]),
        ArgumentError("no", text=f"{HOSTILE};", span=ssduck.errors.SourceSpan(0, 3)),
    ],
)
def test_errors(error):
    text = str(error).replace("\n", "")
    assert text.isprintable()
    assert "[2J" in text
    assert "".join(error._render_traceback_()).replace("\n", "").isprintable()


def test_warnings():
    assert told(warn, f"no {HOSTILE}", ProgramWarning) == [f"no {ESCAPED}"]


def test_a_scene_and_a_record(tmp_path):
    for open_ in (ssduck.load, ssduck.open):
        with pytest.raises(ssduck.SelectScriptError) as caught:
            open_(f"{tmp_path}/{HOSTILE}")
        assert str(caught.value).isprintable()
        assert "[2J" in str(caught.value)
    (tmp_path / "a.toml").write_text(f'[[body]]\nname = "{ESCAPED}"\nbox = [1, 1]\n')
    with pytest.raises(ssduck.SelectScriptError) as caught:
        ssduck.load(tmp_path / "a.toml")
    assert str(caught.value).replace("\n", "").isprintable()


def test_lines_of_a_program_stay_lines():
    with ssduck.Interpreter() as ss, pytest.raises(UnknownNameError) as caught:
        ss.eval("\tnothing;")
    assert str(caught.value).endswith("    \tnothing;\n    \t^^^^^^^")


@pytest.fixture
def hostile():
    with Stage() as stage, ssduck.Interpreter() as ss:
        stage.sphere(HOSTILE, radius=0.1, mass=1)
        ss.add_variable("lab", stage.open())
        yield ss


class Terminal(io.StringIO):
    encoding = "utf-8"

    def isatty(self):
        return True


@pytest.mark.parametrize("format", ["table", "csv", "json", "markdown"])
@pytest.mark.parametrize(
    "program", ["SELECT id FROM lab AS list;", "SELECT id FROM lab;", "SELECT this FROM lab;"]
)
def test_answers_on_a_terminal(hostile, monkeypatch, format, program):
    terminal = Terminal()
    monkeypatch.setattr(sys, "stdout", terminal)
    print_value(hostile.eval(program), FORMATS[format])
    text = terminal.getvalue()
    assert "[2J" in text
    # A terminal gets the letters of heads in bold.
    for sequence in ("\x1b[2J", "\x9b", "\u202e", "\r"):
        assert sequence not in text
    if format == "json":
        (row,) = json.loads(text)
        assert HOSTILE in (row if isinstance(row, str) else row.values())


def test_files_have_names_as_they_are(hostile):
    value = hostile.eval("SELECT id FROM lab;")
    assert json.loads(text_of(value, FORMATS["json"])) == [{"id": HOSTILE}]
    assert list(csv.reader(io.StringIO(text_of(value, FORMATS["csv"]), newline="")))[1] == [HOSTILE]


def test_what_python_shows(hostile):
    world = hostile.call_variable("lab")
    values = hostile.eval("SELECT id FROM lab AS list;")
    view = TableView(values)
    shown = [repr(world), repr(list(world)), view.text(), view._repr_html_()]
    for text in shown:
        assert "[2J" in text
        assert text.replace("\n", "").isprintable()


def test_lines_of_values_stay_lines():
    assert TableView(["a\n\tb\x07"]).text() == "a\n\tb\\u0007"
