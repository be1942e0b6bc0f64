"""What the README and the manual show is run, and what comes from the code is up to date."""

import ast
import os
import re
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

import ssduck
from ssduck.language.parser import parse
from tests.support.cases import sampled
from tests.support.opengl import skip_without_opengl
from tests.support.timing import HANGS

ROOT = Path(__file__).resolve().parents[2]
NAMES = ("README.md", "CONTRIBUTING.md", "CHANGELOG.md")
NAMES += ("tools/README.md", "examples/cleanup/README.md")
PAGES = [path for name in NAMES if (path := ROOT / name).exists()]
PAGES += sorted((ROOT / "docs").rglob("*.md"))
FENCE = re.compile(r"^```(\w+)\n(.*?)^```$", re.MULTILINE | re.DOTALL)


def blocks(language):
    """The fenced blocks of a language, by page."""
    found = {}
    for page in PAGES:
        texts = [
            text
            for name, text in FENCE.findall(page.read_text(encoding="utf-8"))
            if name == language
        ]
        if texts:
            found[page.relative_to(ROOT).as_posix()] = texts
    return found


# A part begins where a scene is loaded anew, or a library that may be missing is imported.
BEGINNINGS = ("import ssduck\n\nss = ssduck.load(", "import gymnasium\n", "import jax\n")


def parts():
    """The pages' Python, and what is shown as printed, in parts that need none of the others."""
    for page in PAGES:
        texts, shown, number = [], [], 0
        for language, text in FENCE.findall(page.read_text(encoding="utf-8")):
            if language == "python":
                if texts and text.startswith(BEGINNINGS):
                    yield pytest.param(texts, shown, id=f"{page.relative_to(ROOT)} {number}")
                    texts, shown, number = [], [], number + 1
                texts.append(text)
            elif language == "text":
                shown.append(text)
        if texts:
            yield pytest.param(texts, shown, id=f"{page.relative_to(ROOT)} {number}")


@pytest.mark.slow
@pytest.mark.parametrize(("texts", "shown"), [*parts()])
def test_python_examples_run(texts, shown, request, tmp_path, monkeypatch, capsys):
    for library in ("mujoco", "jax"):
        if any(f"import {library}\n" in text for text in texts):
            pytest.importorskip(library)
    if any("ssduck.render" in text for text in texts):
        skip_without_opengl()
    monkeypatch.chdir(tmp_path)
    namespace = {}
    for text in texts:
        exec(compile(text, request.node.name, "exec"), namespace)  # noqa: S102
    for value in list(namespace.values()):
        if isinstance(value, ssduck.Interpreter):
            value.close()
    printed = capsys.readouterr().out.strip()
    for text in shown:
        assert text.strip() in printed


# What README's first command does not install, beside one simulator or the other.
EXTRAS = (
    "clingo",
    "coal",
    "gymnasium",
    "hypothesis",
    "matplotlib",
    "networkx",
    "pandas",
    "polars",
    "pydot",
)


BARE = """
import sys
from importlib.machinery import PathFinder
find = PathFinder.find_spec
def find_spec(name, path=None, target=None):
    return None if name.partition(".")[0] in {} else find(name, path, target)
PathFinder.find_spec = find_spec
"""


def run_bare(text, folder, without="mujoco"):
    """Run Python without the extras, in a process of its own: its output, or its last words."""
    done = subprocess.run(
        [sys.executable, "-c", BARE.format((*EXTRAS, without)) + text],
        cwd=folder,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
        capture_output=True,
        text=True,
        timeout=HANGS,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


@pytest.mark.slow
@sampled(("simulator", "runs"), [("pybullet", 1), ("pybullet", 2), ("mujoco", 2)], every=3)
def test_readme_runs_as_its_first_command_leaves_it(tmp_path, simulator, runs):
    """With either simulator, without pandas and other extras; and once more in the same folder."""
    pytest.importorskip(simulator)
    other = "mujoco" if simulator == "pybullet" else "pybullet"
    needed = ("import gymnasium", f"import {other}")
    shown = [
        text
        for text in blocks("python")["README.md"]
        if not any(line.startswith(needed) for line in text.splitlines())
    ]
    for _ in range(runs):
        run_bare("\n".join(shown), tmp_path, without=other)


MISSING = [
    ("ss.sql('SELECT 1').df()", "pandas"),
    ("ss.sql('SELECT 1').pl()", "polars"),
    ("ss.eval('SELECT this FROM [1] AS df;')", "pandas"),
    ("ss.eval('SELECT this FROM [1] AS polars;')", "polars"),
    ("ss.eval('SELECT this FROM [1] AS table;').df()", "pandas"),
]


@pytest.mark.slow
def test_a_library_that_is_missing_is_named(tmp_path):
    told = run_bare(
        f"""
import ssduck
with ssduck.Interpreter() as ss:
    for call, _ in {MISSING}:
        try:
            eval(call)
        except ssduck.SelectScriptError as error:
            print(type(error).__name__, error, end="\\0")
""",
        tmp_path,
    )
    errors = told.split("\0")
    assert errors.pop() == ""
    for error, (call, extra) in zip(errors, MISSING, strict=True):
        assert error.startswith("UnsupportedError "), call
        assert f"pip install 'ssduck[{extra}]'" in error
        assert len(error.splitlines()) == 1 or "^" in error.splitlines()[-1]


SHOWN = re.compile(r"^;?[ \t]*\n?[ \t]*# -> (.*)")


def examples(text):
    """The statements of a block, each with the value that is shown behind it, if there is one."""
    program = parse(text)
    if program.explain:
        return [(text, None)]
    return [
        (text[s.span.start : s.span.end] + ";", SHOWN.match(text[s.span.end :]))
        for s in program.statements
    ]


@pytest.mark.slow
@pytest.mark.parametrize(("page", "texts"), blocks("selectscript").items())
def test_selectscript_examples_run(page, texts):
    with ssduck.load("kitchen") as ss:
        for text in texts:
            for part, shown in examples(text):
                value = ss.eval(part)
                if shown is None:
                    assert value not in (None, [], {}), f"{page}: an example that shows nothing"
                else:
                    expected = ast.literal_eval(shown[1])
                    assert rounded(value) == expected, f"{page}: {part}"
                    assert type(value) is type(expected)


def rounded(value):
    """With all floats as short as the manual shows them."""
    if isinstance(value, float):
        return round(value, 9)
    if isinstance(value, list):
        return [rounded(element) for element in value]
    if isinstance(value, dict):
        return {key: rounded(element) for key, element in value.items()}
    return value


def test_the_guard_against_an_empty_run():
    assert sum(map(len, blocks("python").values())) >= 8
    assert sum(map(len, blocks("selectscript").values())) >= 4


@pytest.mark.parametrize("text", [t for texts in blocks("toml").values() for t in texts])
def test_toml_examples_parse(text):
    assert tomllib.loads(text)


def anchors(page):
    """The anchors of a page's headings, as GitHub makes them."""
    text = FENCE.sub("", page.read_text(encoding="utf-8"))
    headings = re.findall(r"^#+ (.*)$", text, re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", heading).lower().replace(" ", "-") for heading in headings}


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.relative_to(ROOT).as_posix())
def test_links_lead_somewhere(page):
    text = FENCE.sub("", page.read_text(encoding="utf-8"))
    for target, anchor in re.findall(r"\]\(([^)#\s]*)#?([^)\s]*)\)", text):
        if not target.startswith("https://"):
            path = page.parent / target if target else page
            assert path.exists(), target
            assert not anchor or anchor in anchors(path), f"{target}#{anchor}"


CODE = [path for top in ("ssduck", "tools", "benchmarks") for path in (ROOT / top).rglob("*.py")]
MENTION = re.compile(r"\bdocs/[\w/.-]*\.(?:md|png)\b")


@pytest.mark.slow
def test_pages_that_the_code_mentions_exist():
    mentions = {
        (path.relative_to(ROOT).as_posix(), name)
        for path in [*CODE, ROOT / "Makefile", ROOT / "pyproject.toml"]
        for name in MENTION.findall(path.read_text(encoding="utf-8"))
    }
    assert mentions
    assert [mention for mention in mentions if not (ROOT / mention[1]).exists()] == []


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.relative_to(ROOT).as_posix())
def test_modules_that_pages_mention_exist(page):
    """Paths in code spans, from the repository or from its package; but for `two_boxes`, a stub."""
    text = FENCE.sub("", page.read_text(encoding="utf-8"))
    paths = re.findall(r"`((?:\w+/)+(?:\w+\.py)?)`", text)
    places = [(ROOT / path, ROOT / "ssduck" / path) for path in paths if "two_boxes" not in path]
    assert [a for a, b in places if not a.exists() and not b.exists()] == []


def test_every_package_is_in_the_manual():
    page = (ROOT / "docs" / "explanation" / "how-it-works.md").read_text(encoding="utf-8")
    packages = {path.parent.name for path in (ROOT / "ssduck").glob("*/__init__.py")}
    assert len(packages) > 8
    assert {name for name in packages if f"`{name}" not in page} == set()
