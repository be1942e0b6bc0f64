"""`ssduck lake`, `ask` and `tag`."""

import json

import duckdb
import pytest

import ssduck
from tests.support.command_line import answer, ssduck_


@pytest.fixture(scope="module")
def runs(tmp_path_factory):
    folder = tmp_path_factory.mktemp("lake") / "runs"
    tables = ssduck.Recording(tables=("links", "contacts"))
    for task in ("drop", "place"):
        with (
            ssduck.load("kitchen", recording=None) as ss,
            ss.record_to(folder, recording=tables, tags={"task": task}),
        ):
            ss.run(0.05)
    return str(folder)


@pytest.mark.slow
def test_a_table_of_episodes_fits_a_terminal(runs):
    heading = answer("lake", runs).splitlines()[0].split()
    assert heading[:4] == ["path", "world", "episode", "started"]
    assert "entities" not in heading
    whole = json.loads(answer("lake", runs, "-F", "json"))
    assert {"id", "entities", "tables"} <= whole[0].keys()


@pytest.mark.slow
def test_lake_ask_and_tag(runs):
    assert answer("tag", runs, "lab=b12", "--where", "task = 'drop'") == "lab: 1 episode\n"
    program = "held=heldFor(above(kitchen.table, kitchen.can)) < 100;"
    assert answer("tag", runs, "--program", program) == "held: 2 episodes\n"
    listed = json.loads(answer("lake", runs, "-F", "json", "--where", "held AND lab = 'b12'"))
    assert [(row["world"], row["episode"], row["task"]) for row in listed] == [
        ("kitchen", 0, "drop")
    ]
    rows = json.loads(answer("ask", runs, "z(kitchen.fridge);", "-F", "json", "-w", "episode = 1"))
    assert [(row["episode"], row["error"]) for row in rows] == [(1, None)]
    assert rows[0]["answer"] == pytest.approx(1.55, abs=0.1)


@pytest.mark.slow
def test_ask_writes_sql(runs, tmp_path):
    program = "SELECT id FROM kitchen WHERE z(this) > 1;"
    told = answer("ask", runs, program, "-w", "episode = 1", "--sql", "duckdb")
    asked = json.loads(answer("ask", runs, program, "-w", "episode = 1", "-F", "json"))
    with duckdb.connect() as connection:
        rows = connection.execute(told).fetchall()
    assert [row[3] for row in rows] == [row["id"] for row in asked]
    assert len(rows) > 1
    assert answer("ask", runs, program, "--sql", "spark", "-o", str(tmp_path / "above.sql")) == ""
    assert f"parquet.`{runs}/entities/world=kitchen`" in (tmp_path / "above.sql").read_text()
    result = ssduck_("ask", runs, "on(kitchen.table, kitchen.can);", "--sql", "spark")
    assert "on, which compares shapes, is not written as SQL" in result.stderr


@pytest.mark.slow
def test_errors_of_episodes_end_with_1(runs):
    result = ssduck_("ask", runs, "z(kitchen.spoo);")
    assert result.exit_code == 1
    assert "2 episodes without an answer" in result.stderr
    assert "no entity" in result.stdout


@pytest.mark.slow
@pytest.mark.filterwarnings("default")
def test_a_doubt_is_told_and_an_error_of_strict_questions(runs):
    program = "count(SELECT id FROM kitchen WHERE kind=='robto' AS list);"
    result = ssduck_("ask", runs, program, "-F", "json")
    assert [row["answer"] for row in json.loads(result.stdout)] == [0, 0]
    assert result.stderr.count("did you mean 'robot'?") == 1
    result = ssduck_("ask", runs, program, "-F", "json", "--strict")
    assert result.exit_code == 1
    assert all("did you mean 'robot'?" in row["error"] for row in json.loads(result.stdout))


@pytest.mark.slow
def test_mistakes(runs):
    for arguments, message in (
        (("ask", runs, "1;", "--where", "tsk = 1"), "did you mean"),
        (("tag", runs), "there is no tag"),
        (("tag", runs, "--program", "1;"), "has no name"),
        (("lake", f"{runs}/none"), "there is no record"),
    ):
        result = ssduck_(*arguments)
        assert result.exit_code in (1, 2)
        assert message in result.stderr


@pytest.mark.filterwarnings("default")
@pytest.mark.parametrize("command", [("lake",), ("ask", "1;"), ("tag", "seen=1")])
def test_a_condition_that_holds_for_no_episode_is_told(runs, command):
    name, *rest = command
    result = ssduck_(name, runs, *rest, "--where", "task = 'dorp'")
    assert "none has the task 'dorp'; did you mean 'drop'?" in result.stderr
    assert result.exit_code == 0
