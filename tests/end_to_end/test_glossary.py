"""The manual, its generated pages and the public docstrings use the terms of the glossary."""

import inspect
import re
from pathlib import Path

import pytest

import ssduck

ROOT = Path(__file__).resolve().parents[2]
GLOSSARY = ROOT / "docs" / "glossary.md"
NAMES = ("README.md", "CONTRIBUTING.md", "CHANGELOG.md")
NAMES += ("tools/README.md", "examples/cleanup/README.md")
PAGES = [ROOT / name for name in NAMES]
PAGES += sorted(path for path in (ROOT / "docs").rglob("*.md") if path != GLOSSARY)

CODE_BLOCK = re.compile(r"^```.*?^```$|^(?: {4}|>>>|\.\.\. ).*?$", re.MULTILINE | re.DOTALL)
CODE_SPAN = re.compile(r"(`+)[^`]+\1")
COMMA = re.compile(r",\s*(?![^()]*\))")  # outside parentheses


def table_rows():
    """Returns the cells of all rows of the glossary's tables."""
    lines = GLOSSARY.read_text(encoding="utf-8").splitlines()
    rows = [[cell.strip() for cell in line[1:-1].split("|")] for line in lines if line[:1] == "|"]
    return [row for row in rows if row[0] != "term" and not row[0].startswith("---")]


def forbidden_words():
    """Returns the glossary's term for each word of its last column without a parenthesis."""
    return {
        word: term
        for term, _, words in table_rows()
        for word in COMMA.split(words)
        if word and "(" not in word
    }


FORBIDDEN = forbidden_words()
PATTERN = re.compile(
    r"(?<![\w-])("
    + "|".join(re.escape(word).replace(r"\ ", r"\s+") for word in FORBIDDEN)
    + r")(?:e?s)?(?![\w-])",
    re.IGNORECASE,
)


def prose(text):
    """Returns a text without its code; line breaks stay."""
    for pattern in (CODE_BLOCK, CODE_SPAN):
        text = pattern.sub(lambda code: "\n" * code[0].count("\n"), text)
    return text


def violations(text):
    """Returns the line, the forbidden word and the right term of each violation."""
    text = prose(text)
    return [
        (text.count("\n", 0, match.start()) + 1, word, f"use: {FORBIDDEN[word]}")
        for match in PATTERN.finditer(text)
        for word in [" ".join(match[1].lower().split())]
    ]


def public_docstrings():
    """Returns the docstrings of the public names and of their public methods, not indented."""
    values = {name: getattr(ssduck, name) for name in ssduck.__all__}
    for name, value in list(values.items()):
        if inspect.isclass(value):
            members = inspect.getmembers(value)
            values |= {f"{name}.{key}": part for key, part in members if not key.startswith("_")}
    return {
        name: "\n".join(line.strip() for line in value.__doc__.splitlines())
        for name, value in values.items()
        if callable(value) or isinstance(value, property)
        if value.__doc__ and (getattr(value, "__module__", None) or "ssduck").startswith("ssduck")
    }


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.relative_to(ROOT).as_posix())
def test_pages_use_the_terms(page):
    assert violations(page.read_text(encoding="utf-8")) == []


def test_public_docstrings_use_the_terms():
    texts = public_docstrings()
    assert len(texts) > 60
    assert {name: bad for name, text in texts.items() if (bad := violations(text))} == {}


def test_the_glossary_is_consistent():
    """Each term has one row, a meaning and no word that is a term itself."""
    rows = table_rows()
    terms = [part.lower() for term, _, _ in rows for part in COMMA.split(term)]
    assert len(terms) == len(set(terms)) > 60
    assert all(len(row) == 3 and row[1] for row in rows)
    assert len(FORBIDDEN) > 30
    assert set(FORBIDDEN).isdisjoint(terms)


def test_the_check_finds_words_in_prose_only():
    assert violations("A simulation\ntime.\nTwo hinges.") == [
        (1, "simulation time", "use: simulated time"),
        (3, "hinge", "use: joint"),
    ]
    assert (
        violations("`hinge`, hinged, a hinge_joint\n\n```text\nhinge\n```\n    hinge = 1\n") == []
    )
