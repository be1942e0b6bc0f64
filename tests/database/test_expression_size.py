"""The size of a regular expression, against expressions whose sizes are known as they are built."""

from __future__ import annotations

import random

import pytest

from ssduck.database.strict.expression_size import expression_size

LETTERS = ["a", ".", r"\d", "[ab]", r"\{", "[]}]", r"\x{61}", "[^]{9}]", "[[:alpha:]]", r"[\]]"]


def built(random, depth):
    """Returns an expression and its size."""
    kind = random.randrange(6) if depth else 0
    if kind <= 1:
        return random.choice(LETTERS), 1
    inner, size = built(random, depth - 1)
    if kind == 2:
        return f"({random.choice(['', '?:', '?P<n>', '?i:'])}{inner})", size + 2
    if kind == 3:
        other, more = built(random, depth - 1)
        return inner + other, size + more
    if kind == 4:
        most = random.randrange(1, 5)
        counts = random.choice([f"{{{most}}}", f"{{{random.randrange(most + 1)},{most}}}"])
        return f"({inner}){counts}", (size + 2) * most
    return f"({inner}){random.choice('*+?')}", size + 3


@pytest.mark.parametrize("seed", range(3))
def test_sizes(seed):
    source = random.Random(seed)  # noqa: S311  # no secret
    for _ in range(1000):
        text, size = built(source, 6)
        assert expression_size(text) == size


@pytest.mark.parametrize(
    ("text", "size"),
    [
        ("a{1,1000}b", 1001),
        ("a{5,}", 6),
        ("((a{1,10}){1,10}){1,10}b", 1221),
        (r"\pL{3}\P{Greek}", 80),
        (r"[\pL\pN]{2}", 82),
        (r"\Qa{5}\E", 4),
        ("a{,5}", 5),  # no repeat
        ("{3}", 3),
        ("a)))", 7),
        ("(((", 0),
        (f"a{{{10**30}}}", 10**30),
    ],
)
def test_odd_expressions(text, size):
    """Whether DuckDB takes it or not."""
    assert expression_size(text) == size
