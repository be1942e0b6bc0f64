"""Published scripts: four colours, IF and print."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import product

import pytest

# -- four colours --------------------------------------------------------------------------------


COLORS = ["red", "green", "blue", "yellow"]

FIVE = ["ab", "ac", "ad", "ae", "bc", "bd", "cd", "de"]


def colourings(regions: str, borders: Sequence[str]) -> list[dict[str, str]]:
    """By brute force, in the order of the sources."""
    found = (
        dict(zip(regions, chosen, strict=True)) for chosen in product(COLORS, repeat=len(regions))
    )
    return [chosen for chosen in found if all(chosen[a] != chosen[b] for a, b in borders)]


COLOUR_MAP_X = """ colors     = ['red', 'green', 'blue', 'yellow'];

              neighbours = [["a", "b"], ["a", "c"], ["a", "d"], ["a", "e"], 
                            ["b", "c"], ["b", "d"], ["c", "d"], ["d", "e"]];

              SELECT a.this,   b.this,   c.this,   d.this,   e.this
              FROM   a=colors, b=colors, c=colors, d=colors, e=colors                     
              WHERE  [] == SELECT a.this 
                           FROM neighbours
                           WHERE eval(this[0]+".this;") == eval(this[1]+".this;")
                           AS list
              AS dict;              
              """  # noqa: W291

NEIGHBOURS_OF_FIVE = """
colors     = ['red', 'green', 'blue', 'yellow'];

neighbours = [[a.this, b.this], [a.this, c.this], [a.this, d.this], [a.this, e.this], 
              [b.this, c.this], [b.this, d.this], [c.this, d.this], [d.this, e.this]];

SELECT a.this,   b.this,   c.this,   d.this,   e.this
FROM   a=colors, b=colors, c=colors, d=colors, e=colors                     
"""  # noqa: W291

COLOUR_MAP_XX = f"""{NEIGHBOURS_OF_FIVE}WHERE  [] == SELECT this
             FROM neighbours
             WHERE this[0] == this[1]
             AS list
AS dict;"""

PAIRS_OF_FIVE = ", ".join(f"[{a}.this, {b}.this]" for a, b in FIVE)


@pytest.mark.slow
@pytest.mark.parametrize(
    "program",
    [
        COLOUR_MAP_X,
        COLOUR_MAP_XX,
        COLOUR_MAP_XX.replace("FROM neighbours", f"FROM [{PAIRS_OF_FIVE}]"),
    ],
    ids=["texts", "a variable", "a list"],
)
def test_five_regions(ss, program):
    assert ss.eval(ss.compile(program)) == colourings("abcde", FIVE)


# -- IF and print --------------------------------------------------------------------------------


IF_PRINT = {
    """ IF(False; "fuck", 2, 55; 22, "fffuck"); """: "fffuck",
    """
b = IF ( 2<3;
         a=1., 2.; # then
         a=2., 1.);# else
a/b;
""": 0.5,
    """
b = IF ( 2>3;
         a=1., 2.; # then
         a=2., 1.);# else
a/b;
""": 2.0,
    """print("what", "shall", [1,2,3], "I", "print", False);""": False,
}

COUNTING = f"""# counting the positive and negative combinations within WHERE ...
positive   = 0;
negative   = 0;
{NEIGHBOURS_OF_FIVE}WHERE  IF( [] == SELECT this
                 FROM neighbours
                 WHERE this[0] == this[1]
                 AS list;
            positive = positive + 1, True;
            negative = negative + 1, False)
AS dict;

[positive, negative];"""

LOGGING = f"""# logging all results by applying print(..., ..., ...), the last parameter is always the return value
counter    = 0;{NEIGHBOURS_OF_FIVE}WHERE  print("log:",
             counter=counter+1,
             a.this,   b.this,   c.this,   d.this,   e.this,
             
             [] == SELECT this
                   FROM neighbours
                   WHERE this[0] == this[1]
                   AS list)
AS dict;"""  # noqa: W293

PRINTING = f"""# combining if and print to log only results where a is of red color{NEIGHBOURS_OF_FIVE}WHERE  IF( [] == SELECT this
                 FROM neighbours
                 WHERE this[0] == this[1]
                 AS list;
            IF( a.this == "red";
                print(a.this,   b.this,   c.this,   d.this,   e.this)),
            True;
            False)
AS dict;"""


@pytest.mark.parametrize("program", IF_PRINT)
def test_if_and_print(ss, program):
    assert ss.eval(ss.compile(program)) == IF_PRINT[program]


@pytest.mark.slow
def test_positive_and_negative_combinations(ss):
    found = len(colourings("abcde", FIVE))
    assert ss.eval(ss.compile(COUNTING)) == [found, 4**5 - found]


@pytest.mark.slow
def test_each_combination_is_logged(ss, capsys):
    expected = colourings("abcde", FIVE)
    assert ss.eval(ss.compile(LOGGING)) == expected
    lines = capsys.readouterr().out.splitlines()
    assert len(lines) == 4**5
    chosen = product(COLORS, repeat=5)
    for number, (line, colours) in enumerate(zip(lines, chosen, strict=True), 1):
        told = dict(zip("abcde", colours, strict=True)) in expected
        assert line == f"log: {number} {' '.join(colours)} {told}"


@pytest.mark.slow
def test_what_is_red_is_printed(ss, capsys):
    expected = colourings("abcde", FIVE)
    assert ss.eval(ss.compile(PRINTING)) == expected
    red = [" ".join(found.values()) for found in expected if found["a"] == "red"]
    assert capsys.readouterr().out.splitlines() == red
