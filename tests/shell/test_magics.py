"""The magics of notebooks, in a shell of IPython."""

import pytest

import ssduck
from ssduck.adapters.result import Result
from ssduck.errors import ArgumentError, SelectScriptError, UnknownNameError


class Shell:
    """What a magic needs of IPython's shell."""

    def __init__(self, **names):
        self.user_ns, self.magics = names, {}

    def register_magic_function(self, function, kind, name):
        assert kind == "line_cell"
        self.magics[name] = function


@pytest.fixture(scope="module")
def ss():
    with ssduck.load("hall") as loaded:
        yield loaded


@pytest.fixture(scope="module")
def other():
    with ssduck.Interpreter() as made:
        yield made


def magics(**names):
    shell = Shell(**names)
    ssduck.load_ipython_extension(shell)
    return shell.magics


PROGRAM = "SELECT id(this) FROM hall WHERE id(this) == 'goal' AS list;"


@pytest.mark.slow
def test_a_cell_and_a_line(ss):
    found = magics(ss=ss, _=ss, same=ss)
    assert found["selectscript"]("", PROGRAM) == ["goal"]
    assert found["selectscript"](PROGRAM) == ["goal"]
    result = found["sql"]("", "SELECT name FROM entities WHERE name = 'goal'")
    assert isinstance(result, Result)
    assert result.fetchall() == [("goal",)]


def test_why_is_a_tree_that_a_notebook_shows(ss):
    program = "isRobot(hall.goal);"
    why = magics(ss=ss)["selectscript"]("", f"WHY {program}")
    assert why == ss.why(program)
    assert hasattr(why, "_repr_html_")


def test_the_interpreter_of_a_name(ss, other):
    found = magics(ss=ss, other=other)
    assert found["selectscript"](" ss ", PROGRAM) == ["goal"]
    with pytest.raises(
        ArgumentError, match=r"several interpreters: ss, other; .* %%selectscript ss"
    ):
        found["selectscript"]("", PROGRAM)
    with pytest.raises(ArgumentError, match="several"):
        found["sql"]("SELECT 1")
    with pytest.raises(UnknownNameError, match="did you mean 'other'"):
        found["selectscript"]("othr", PROGRAM)


def test_no_interpreter():
    with pytest.raises(UnknownNameError, match=r"ss = ssduck\.load"):
        magics(x=1)["sql"]("SELECT 1")


def test_in_ipython(ss, capsys, tmp_path, monkeypatch):
    monkeypatch.setenv("IPYTHONDIR", str(tmp_path))
    interactive = pytest.importorskip("IPython.core.interactiveshell", reason="no IPython")
    shell = interactive.InteractiveShell(user_ns={"ss": ss})
    try:
        shell.run_line_magic("load_ext", "ssduck")
        assert shell.run_cell(f"%%selectscript\n{PROGRAM}").result == ["goal"]
        braces = "SELECT count(*) > 0 FROM hall{0.0} AS value;"
        assert shell.run_cell(f"%selectscript {braces}").result is True
        assert shell.run_cell("%selectscript '{6 * 7}';").result == "{6 * 7}"
        shell.run_cell("rows = %sql SELECT 6 * 7 AS n")
        assert shell.user_ns["rows"].fetchall() == [(42,)]
        capsys.readouterr()
        outcome = shell.run_cell("%%selectscript\nSELECT idd FROM hall;")
        assert isinstance(outcome.error_in_exec, SelectScriptError)
        out = capsys.readouterr().out
        assert "           ^^^" in out
        assert "did you mean 'id'" in out
        assert "/ssduck/interpreter" not in out
    finally:
        shell.history_manager.end_session()
