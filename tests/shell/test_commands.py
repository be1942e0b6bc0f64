"""The shell without a terminal: statements, commands, modes, and what fails."""

import json
from urllib.error import URLError
from urllib.request import urlopen

import pytest

import ssduck
from ssduck.shell.session import COMMANDS, Session, run_lines
from tests.support.command_line import ssduck_
from tests.support.timing import HANGS


@pytest.fixture(scope="module")
def ss():
    with ssduck.load("hall") as loaded:
        yield loaded


@pytest.fixture
def session(ss):
    return Session(ss)


def typed(session, capsys, *lines):
    """Whether all lines succeed, what they print, and what they complain of."""
    succeeded = run_lines(session, [f"{line}\n" for line in lines])
    return succeeded, *capsys.readouterr()


COMPLETE = [
    ("selectscript", "1;", True),
    ("selectscript", "1", False),
    ("selectscript", "", True),
    ("selectscript", " \n", True),
    ("selectscript", ".time", True),
    ("selectscript", "1; ", True),
    ("selectscript", "1; // the end", True),
    ("selectscript", "1; /* the", False),
    ("selectscript", "1 // no;", False),
    ("selectscript", "'a;", False),
    ("selectscript", "'a;';", True),
    ("selectscript", "'a;'", False),
    ("selectscript", "1;\n2", False),
    ("sql", "SELECT 1;", True),
    ("sql", "SELECT 1; -- the end", True),
    ("sql", "SELECT 1 -- no;", False),
    ("sql", "SELECT 1 /* no; */", False),
    ("sql", "SELECT 'a;", False),
    ("sql", 'SELECT 1 AS "a;"', False),
    ("sql", "SELECT 7 // 2;", True),
]


@pytest.mark.parametrize(("language", "text", "is_complete"), COMPLETE)
def test_a_statement_ends_with_a_semicolon(session, language, text, is_complete):
    session.language = language
    assert session.is_complete(text) == is_complete


def test_programs_keep_their_variables(session, capsys):
    assert typed(session, capsys, "n = 20;", "n +", "", "1;") == (True, "20\n21\n", "")


def test_a_last_statement_needs_no_semicolon(session, capsys):
    session.language = "sql"
    assert typed(session, capsys, "SELECT 1 AS n") == (True, "n\n-\n1\n", "")


def test_modes(session, capsys):
    lines = [".mode sql json", "SELECT 6 * 7 AS n;", ".mode", ".mode selectscript", "[1];"]
    assert typed(session, capsys, *lines) == (True, '[\n{"n": 42}\n]\nsql, json\n[1]\n', "")


def test_a_failed_query_leaves_everything_as_it_was(session, capsys):
    typed(session, capsys, "kept = 1;")
    result = session.result
    succeeded, out, err = typed(session, capsys, "kept = 2; SELECT idd FROM hall;", "kept;")
    assert (succeeded, out) == (False, "1\n")
    assert err.startswith(
        "error: there is no function 'idd', and no variable; the worlds are hall; did you mean"
    )
    assert err.endswith("           ^^^\n")
    assert result == 1


def test_ctrl_c_stops_a_query_and_not_the_shell(session, capsys):
    def press():
        raise KeyboardInterrupt

    session.ss.add_function("press", press)
    try:
        assert typed(session, capsys, "press();", "1;") == (False, "1\n", "interrupted\n")
    finally:
        session.ss.del_function("press")


ERRORS = [
    (".enties", "there is no command .enties; .help lists all; did you mean '.entities'"),
    (".step x", ".step: 'x' is no whole number"),
    (".step -1", ".step: '-1' is no whole number"),
    (".run", ".run needs an argument: .run SECONDS"),
    (".run soon", ".run: 'soon' is no number of seconds"),
    (".run -1", "run: "),
    (".time 5", ".time takes no argument"),
    (".schema entites", "there is no table 'entites'; did you mean 'entities'"),
    (".entities hal", "there is no world 'hal'; did you mean 'hall'"),
    (".mode jsn", "did you mean 'json'"),
    (".mode sql jsn", "did you mean 'json'"),
    (".mode parquet", "there is no mode 'parquet'"),
    (".help nearr", "did you mean 'near'"),
    (".export a.csv", "there is no result to write"),
]


@pytest.mark.parametrize(("line", "told"), ERRORS)
def test_commands_that_fail(session, capsys, line, told):
    time = session.ss["hall"].time
    succeeded, out, err = typed(session, capsys, line)
    assert (succeeded, out) == (False, "")
    assert err.startswith("error: ")
    assert told in err
    assert session.ss["hall"].time == time


def test_each_command_has_its_help(session, capsys):
    _, out, _ = typed(session, capsys, ".help")
    for command in COMMANDS.values():
        assert command.usage in out
        assert command.about.endswith(".")


LISTINGS = [
    (".tables", "entities_history"),
    (".schema", "effort"),
    (".schema entities_history", "zmax"),
    (".relations NEA", "near(a, b, d) -> bool"),
    (".entities", "goal"),
    (".entities hall", "goal"),
    (".help near", "Usage: near(a, b, d) -> bool"),
    (".help AS", "AS list"),
]


@pytest.mark.parametrize(("line", "told"), LISTINGS)
def test_listings(session, capsys, line, told):
    succeeded, out, err = typed(session, capsys, line)
    assert (succeeded, err) == (True, "")
    assert told in out


def test_time_runs(session, capsys):
    world = session.ss["hall"]
    before = world.time
    typed(session, capsys, ".step", ".step 2")
    assert world.time == pytest.approx(before + 3 * world.timestep)
    _, out, _ = typed(session, capsys, ".run 0.1;")
    assert world.time == pytest.approx(before + 3 * world.timestep + 0.1, abs=world.timestep)
    assert str(world.snapshot.number) in out


def test_the_last_result_is_written_in_full(session, capsys, tmp_path):
    path = tmp_path / "numbers.csv"
    session.language = "sql"
    succeeded, out, _ = typed(
        session, capsys, "SELECT i FROM range(100) r(i);", f".export {path}", ".quit", "SELECT 1;"
    )
    assert succeeded
    assert out.endswith(f"{path}\n")
    assert path.read_text() == "i\n" + "".join(f"{i}\n" for i in range(100))


@pytest.mark.slow
def test_the_command_reads_a_pipe(tmp_path):
    result = ssduck_("shell", "hall", "--sql", input=".mode json\nSELECT 1 AS n;\nSELECT m;\n")
    assert result.exit_code == 1
    assert json.loads(result.stdout) == [{"n": 1}]
    assert "Binder Error" in result.stderr


@pytest.mark.slow
def test_strict(tmp_path):
    program = f"COPY (SELECT 1) TO '{tmp_path}/a.csv';"
    result = ssduck_("shell", "hall", "--sql", "--strict", input=program)
    assert (result.exit_code, result.stdout) == (1, "")
    assert not list(tmp_path.iterdir())


@pytest.mark.slow
def test_a_record(tmp_path):
    with ssduck.load("hall") as ss:
        ss.run(0.02)
        ss.export(tmp_path / "run")
    result = ssduck_("shell", str(tmp_path / "run"), input=".step\nSELECT 1 AS n;\n", env={})
    assert result.exit_code == 1
    assert result.stderr.startswith("error: ")


def test_view_serves_a_page_until_the_session_ends(session, capsys):
    pytest.importorskip("websockets")
    succeeded, out, _ = typed(session, capsys, ".view hall")
    url = out.strip()
    assert succeeded
    assert url.startswith("http://127.0.0.1:")
    assert b"<html" in urlopen(url, timeout=HANGS).read()  # noqa: S310
    session.close()
    with pytest.raises(URLError):
        urlopen(url, timeout=HANGS)  # noqa: S310
    session.close()


def test_view_of_no_world_is_an_error(session, capsys):
    pytest.importorskip("websockets")
    succeeded, _, err = typed(session, capsys, ".view hal")
    assert not succeeded
    assert "did you mean 'hall'" in err
    assert not session.pages
