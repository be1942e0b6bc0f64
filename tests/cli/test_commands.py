"""The other commands of `ssduck`, the completion of bash, and the manual."""

import os
import re
import shlex
import shutil
import signal
import subprocess
import sys
import urllib.request
from pathlib import Path

import pytest
import typer
from PIL import Image

import ssduck
from ssduck.cli.app import app
from ssduck.demos.kitchen import KITCHEN
from tests.support.cases import sampled
from tests.support.command_line import ROOT, answer, run, ssduck_

PAGE = (ROOT / "docs" / "reference" / "command-line.md").read_text(encoding="utf-8")


# -- the other commands --------------------------------------------------------------------------


def test_scenes():
    written = answer("scenes")
    assert "kitchen" in written
    assert "four robots" in written


@pytest.mark.slow
def test_functions():
    written = answer("functions")
    with ssduck.Interpreter() as ss:
        for name in ss.help():
            assert re.search(rf"^{name}\(.*\)( -> \w+)?  +[A-Z].*\.$", written, re.MULTILINE), name
        assert answer("functions", "distance") == ss.help("distance") + "\n"


@pytest.mark.slow
def test_help():
    assert answer() == answer("--help") == answer("-h")
    group = typer.main.get_command(app)
    for name, command in group.commands.items():
        assert command.help
        assert name in answer("--help")
        shown = answer(name, "--help")
        for parameter in command.params:
            assert parameter.help, f"{name}: {parameter.name}"
            assert all(option in shown for option in parameter.opts if option.startswith("-"))


def test_version():
    assert re.fullmatch(r"ssduck (\d+(\.\d+)+\S*|\(not installed.*\))\n", answer("--version"))


# -- the demonstration ---------------------------------------------------------------------------


# What the tutorial prints, as far as it fits a line here.
TUTORIAL = [
    "answer   6.2",
    "fridge         [-0.87, -2, 1.55]    robot",
    "cooker         [1.98, 1.72, 0.75]   robot",
    "barrett_4918   [0.42, 1.3, 0.892]   robot",
    "roomba_625x    [1.8, 0, 0.17]       robot",
    "[0.000118749, 0.000118749, 0.000118749, 0.00015724, 0.00015724, 0.00015724, 0.00015724]",
    "chair_6b56   0.0307263",
    "chair_083c   0.0255963",
    "[plate_b4e7, [-1.13, 2.01, 1.14]]",
    "Usage: onX(o1, o2) -> bool",
    "[cup_905a, cup_58a2, cup_b6af, cup_d441]",
    "left to Python: onX(table, this)",
    "table       plate_fa76",
    "microwave   pin_c671",
]


@pytest.mark.long  # it takes seconds
def test_demo_in_an_empty_folder(tmp_path):
    code, out, err = run("demo", cwd=tmp_path)
    assert (code, err) == (0, "")
    for shown in (*TUTORIAL, *(question.asks for question in KITCHEN)):
        assert shown in out
    assert re.search(rf"^{len(KITCHEN)} questions in \d+\.\d\d s$", out, re.MULTILINE)
    assert "kitchen.png" in out
    assert "\x1b" not in out
    assert not re.search(r" $", out, re.MULTILINE)
    assert max(map(len, out.splitlines())) <= 100
    folder = tmp_path / "ssduck-demo" / "kitchen"
    assert [p for p in tmp_path.rglob("*") if p.is_file()] == [folder / "kitchen.png"]
    with Image.open(folder / "kitchen.png") as picture:
        assert (picture.format, picture.mode, picture.size) == ("PNG", "RGB", (960, 720))
        assert len(picture.getcolors(maxcolors=960 * 720)) > 500


@pytest.mark.slow
def test_demo_of_another_scene(here):
    pytest.importorskip("pybullet")  # MuJoCo draws where there is OpenGL
    written = answer("demo", "two.toml", "--output", "picture.jpg")
    assert "big     small" in written
    with Image.open("picture.jpg") as picture:
        assert picture.format == "JPEG"


COLOURS = [
    ({}, False),
    ({"FORCE_COLOR": "1"}, True),
    ({"FORCE_COLOR": "1", "NO_COLOR": "1"}, False),
]


@pytest.mark.slow
@pytest.mark.parametrize(("env", "coloured"), COLOURS)
def test_colours(here, env, coloured):
    env = {"NO_COLOR": None, "FORCE_COLOR": None, "TERM": "xterm", **env}
    written = answer("demo", "two.toml", "--no-picture", env=env)
    assert bool(re.search(r"\x1b\[3\d", written)) == coloured


# -- the manual ----------------------------------------------------------------------------------


EXAMPLES = [
    tuple(example.split("\n", 1))
    for block in re.findall(r"^```console\n(.*?)^```$", PAGE, re.MULTILINE | re.DOTALL)
    for example in re.split(r"^\$ ", block, flags=re.MULTILINE)[1:]
]


@pytest.mark.slow
@sampled(("line", "shown"), EXAMPLES, every=3, ids=[line for line, _ in EXAMPLES])
def test_examples_of_the_manual(tmp_path, monkeypatch, line, shown):
    monkeypatch.chdir(tmp_path)
    words = shlex.split(line)
    piped = words[1] if words[0] == "echo" else None
    if "check" in words:
        ssduck_("record", "kitchen", "--seconds", "0.1", "-o", "run", "--tables", "entities")
    result = ssduck_(*words[words.index("ssduck") + 1 :], input=piped)
    assert result.stdout + result.stderr == shown


def test_the_manual_names_every_command_and_option():
    assert len(EXAMPLES) >= 6
    for name, command in typer.main.get_command(app).commands.items():
        assert f"`ssduck {name}" in PAGE
        for parameter in command.params:
            options = [*parameter.opts, *parameter.secondary_opts]
            named = [o for o in options if o.startswith("--") and f"`{o}" in PAGE]
            named += [o for o in options if o.startswith("--") and f", `{o}" in PAGE]
            assert named or not options[0].startswith("-"), f"{name}: {options}"


pytest.importorskip("websockets", reason="the extra view is not installed")


@pytest.mark.slow
def test_the_first_line_is_the_address():
    command = [sys.executable, "-m", "ssduck", "view", "kitchen", "--no-browser"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        url = process.stdout.readline().strip()
        try:
            assert url.startswith("http://127.0.0.1:")
            with urllib.request.urlopen(url, timeout=30) as reply:  # noqa: S310  # its own server
                assert "ssduck" in reply.read().decode()
        finally:
            process.send_signal(signal.SIGINT)
    assert process.returncode == 130


BASH = shutil.which("bash")


@pytest.mark.slow
@pytest.mark.skipif(BASH is None, reason="needs bash")
def test_bash_completes_commands_after_the_installation(tmp_path):
    environment = os.environ | {"HOME": str(tmp_path)}
    environment["PATH"] = f"{Path(sys.executable).parent}:{environment['PATH']}"

    def bash(script):
        return subprocess.run(
            [str(BASH), "-c", script], env=environment, capture_output=True, text=True, check=True
        ).stdout

    bash("ssduck --install-completion; exit $?")  # it asks which shell has called it
    # What bash does when Tab is pressed behind `ssduck vi`.
    script = (
        f"source {next((tmp_path / '.bash_completions').iterdir())}; COMP_WORDS=(ssduck vi); "
        'COMP_CWORD=1; _ssduck_completion ssduck; echo "${COMPREPLY[@]}"'
    )
    assert bash(script).split() == ["view"]
