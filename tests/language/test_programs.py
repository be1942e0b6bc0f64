"""Programs as the published grammar has them: IF, assignments, chains, operators as functions."""

from __future__ import annotations

import math
from functools import partial, reduce, wraps

import pytest

import ssduck
from ssduck.errors import ArgumentError, ParseError, SelectScriptError, UnknownNameError
from ssduck.language.builtins import BUILTINS, Function
from ssduck.language.parser import parse
from ssduck.sql.relations.registry import RELATIONS
from tests.support.cases import sampled
from tests.support.warned import silent

EVALUATORS = {"compiled": {}, "row by row": {"row_by_row": True}}


@pytest.fixture(params=EVALUATORS)
def ss(request):
    with ssduck.Interpreter(**EVALUATORS[request.param]) as found:
        yield found


@pytest.fixture(scope="module", params=EVALUATORS)
def shared(request):
    """An interpreter for programs that make the variables that they read."""
    with ssduck.Interpreter(**EVALUATORS[request.param]) as found:
        yield found


@pytest.fixture(scope="module", params=EVALUATORS)
def kitchen(request):
    with ssduck.load("kitchen") as loaded, ssduck.Interpreter(**EVALUATORS[request.param]) as found:
        found.add_variable("kitchen", loaded.call_variable("kitchen"))
        yield found


# -- IF, assignments, print ---------------------------------------------------------------------

CASES = {
    "IF(True);": True,
    "IF(0);": False,
    "IF([]);": False,
    "IF('a');": True,
    "IF(2; 3);": 3,
    "IF(0; 3);": False,
    "IF(0; 3; IF(0));": False,
    "IF(0; 3; IF(1));": True,
    "n = 2; IF(n == 1; 'a'; IF(n == 2; 'b'; 'c'));": "b",
    "n = 3; IF(n == 1; 'a'; IF(n == 2; 'b'; 'c'));": "c",
    "n = 3; IF(n == 1; 'a'; IF(n == 2; 'b'));": False,
    "n = 1; IF(n == 2; 'a'; IF(n == 1; 'b'), 7);": 7,
    "n = 1; IF(n == 2; 'a'; IF(n == 1; 2) + 5);": 7,
    "n = 1; IF(n == 2; 'a'; (IF(n == 1; 2)));": 2,
    "SELECT IF(this > 1) FROM [1, 2, 3] AS list;": [False, True, True],
    "SELECT IF(this == 1; 'a'; IF(this == 2; 'b'; 'c')) FROM [1, 2, 3] AS list;": ["a", "b", "c"],
    # assignments: each row that comes to one runs it, in the order of the sources
    "n = 0; SELECT n = n + 1, this FROM [5, 6];": [{"n": 1, "this": 5}, {"n": 2, "this": 6}],
    "n = 0; SELECT n = n + 1, n FROM [5, 6] AS list;": [1, 1, 2, 2],
    "n = 0; SELECT this FROM [5, 6] WHERE IF(True; n = n + this, True) AS list; n;": 11,
    "n = 0; SELECT this FROM [0, 6] WHERE n = this AS list;": [0],
    "n = 0; SELECT this FROM [1, 2, 3] WHERE IF(True; n = n + 1, n > 1) AS list;": [2, 3],
    "n = 0; SELECT n = n + this FROM [1, 2, 3] WHERE this > 1 AS list; n;": 5,
    "n = 0; SELECT this FROM [1, 2, 3] WHERE IF(True; n = n + 1, n) LIMIT 2 AS list; n;": 2,
    "n = 0; SELECT a.this, b.this FROM a=[1, 2], b=[3, 4] WHERE IF(True; n = 10 * n + a.this * b.this > 0, n) AS list; n;": True,
    "m = n = 0; SELECT m = n = n + this FROM [1, 2] AS list; [m, n];": [3, 3],
}


@sampled("program", CASES, every=3)
def test_programs(shared, program):
    assert shared.eval(program) == CASES[program]


def test_what_may_be_a_comparison_assigns_nothing_unknown(kitchen):
    with silent():
        assert kitchen.eval("SELECT id FROM kitchen WHERE id = 'table' AS list;") == ["table"]
    with pytest.raises(UnknownNameError, match="no variable 'm'") as caught:
        kitchen.eval("SELECT id FROM kitchen WHERE m = 3 AND True AS list;")
    assert caught.value.column == len("SELECT id FROM kitchen WHERE ") + 1
    for name in ("m", "id"):
        with pytest.raises(UnknownNameError):
            kitchen.call_variable(name)


def test_print_beside_state_variables(ss, capsys):
    program = (
        "SELECT this FROM [1, 2] START WITH l = 1, print('start', l) "
        "CONNECT BY print('step', l, this), l = l + 1 STOP WITH l == 2 AS list;"
    )
    assert ss.eval(program) == [[1, 1], [1, 2], [2, 1], [2, 2]]
    assert capsys.readouterr().out.splitlines() == ["start 1", "step 1 1", "step 1 2"]


def test_what_stands_beside_state_variables_is_evaluated(ss):
    program = (
        "SELECT this FROM [1] START WITH l = 1 CONNECT BY l = l + 1, {} STOP WITH l == 3 AS list;"
    )
    assert ss.eval(program.format("5 + 5")) == [[1, 1, 1]]
    with pytest.raises(SelectScriptError, match="division by zero"):
        ss.eval(program.format("1 / (l - 2)"))


# -- MEMORIZE without a number ------------------------------------------------------------------

WAYS = "edges = [[1, 2], [1, 3], [2, 4], [3, 4], [4, 5], [2, 3], [5, 1]];"
ENDS = {"e.this[1] == 2": 1, "e.this[1] == 4": 2, "e.this[1] == 5": 2, "e.this[1] == 9": 0}


@pytest.mark.parametrize("end", ENDS)
def test_memorize_gives_the_shortest(shared, end):
    """What MEMORIZE n gives for the least n for which it gives anything."""
    query = (
        f"SELECT e.this FROM e=edges WHERE at == e.this[0] AND {end} START WITH at = 1 "
        "CONNECT BY MEMORIZE {} at = e.this[1] STOP WITH at != e.this[0] AS list;"
    )
    found = shared.eval(WAYS + query.format(""))
    assert len(found) == ENDS[end]
    numbered = [shared.eval(WAYS + query.format(n)) for n in range(6)]
    assert found == next((paths for paths in numbered if paths), [])
    assert shared.eval(WAYS + query.format("MAXIMUM 1")) == found[:1]


def test_memorize_ends_where_something_is_found(ss):
    """States without end lie behind it."""
    program = (
        "SELECT this, s FROM [1, 2] WHERE s == 3 AND this == 2 "
        "START WITH s = 0 CONNECT BY MEMORIZE s = s + 1 STOP WITH False AS list;"
    )
    assert len(ss.eval(program)) == 8


# -- chains -------------------------------------------------------------------------------------

MANY = 4_000
CHAINS = {
    "sum": ("+".join(["1"] * MANY), MANY),
    "difference": ("-".join(["1"] * MANY), 2 - MANY),
    "product": ("*".join(["1"] * MANY), 1),
    "quotients": ("1" + " * 3 / 3" * MANY, reduce(lambda x, _: x * 3 / 3, range(MANY), 1)),
    "remainders": ("7" + " % 9" * MANY, 7),
    "powers": ("2" + " ^ 1" * MANY, 2),
    "or": (" OR ".join(["False"] * MANY) + " OR 1", True),
    "and": (" AND ".join(["1"] * MANY) + " AND 0", False),
    "xor": (" XOR ".join(["True"] * (MANY + 1)), True),
    "equal": ("1" + " == 1" * MANY, True),
    "less": ("0 < 2" + " <= 2" * MANY, True),
    "in": ("1" + " IN [True]" * MANY, True),
    "texts": ("'a'" + " + 'b'" * MANY + " == 'a'", False),
    "elements": ("'a'" + "[0]" * MANY, "a"),
    "list": (f"[{', '.join(['1'] * MANY)}] == 1", False),
    "member": (f"{MANY - 1} IN [{', '.join(map(str, range(MANY)))}]", True),
    "statements": ("1; " * MANY + "2", 2),
    "IF": ("".join(f"IF(3777 == {i}; {i}; " for i in range(MANY)) + "0" + ")" * MANY, 3777),
    "brackets": ("(" + ") + (".join(["1"] * MANY) + ")", MANY),
}


@pytest.mark.slow
@sampled("name", CHAINS, every=8)
def test_chains_are_no_nesting(shared, name):
    text, value = CHAINS[name]
    assert shared.eval(f"{text};") == value


# 33 is one more than is nested, 401 one more than SQL joins.
LENGTHS = [2, 32, 3000, 33, 34, 400, 401]


@pytest.mark.slow
@sampled("length", LENGTHS, every=3)
def test_chains_in_queries(shared, length):
    """Against Python, on both sides of where they are kept flat and left to Python."""
    numbers = [0.5, 3, 31, 32, 33, 399, 400, 500]
    shared.add_variable("numbers", numbers * 10)  # more than a query of lists runs row by row with
    every = numbers * 10

    def chosen(condition):
        return shared.eval(f"SELECT this FROM numbers WHERE {condition} AS list;")

    terms = range(length)
    assert chosen(" OR ".join(f"this == {i}" for i in terms)) == [n for n in every if n in terms]
    assert chosen(" AND ".join(f"this != {i}" for i in terms)) == [
        n for n in every if n not in terms
    ]
    odd = [n for n in every if (n in terms) is (length % 2 == 0)]
    assert chosen(" XOR ".join(f"this != {i}" for i in terms)) == odd
    found = shared.eval(f"SELECT {' - '.join(['this'] * length)} FROM numbers AS list;")
    assert found == [reduce(lambda x, _, n=n: x - n, range(length - 1), n) for n in every]
    found = shared.eval(f"SELECT 0.1 {'+ this' * length} FROM numbers AS list;")
    assert found == [reduce(lambda x, _, n=n: x + n, range(length), 0.1) for n in every]


@pytest.mark.slow
@pytest.mark.parametrize("length", [400, 401])
def test_chains_of_relations(length):
    """As SQL, left to Python, explained."""
    kitchen = ssduck.load("kitchen")
    condition = " OR ".join(f"z(this) * 1000 == {i}" for i in range(length))
    program = kitchen.compile(f"SELECT id FROM kitchen WHERE {condition} AS list;")
    expected = [
        e.name
        for e in kitchen.eval("SELECT obj FROM kitchen AS list;")
        if e.position[2] * 1000 in range(length)
    ]
    assert kitchen.eval(program) == expected != []
    assert ("left to Python" in kitchen.explain(program)) is (length > 400)
    if length <= 400:
        assert program.sql().count("OR") == length - 1
    kitchen.close()


def test_mistakes_in_chains_have_their_place(ss):
    with pytest.raises(ArgumentError, match="does not take") as caught:
        ss.eval("1" + " + 1" * 50 + " + 'a' + 2;")
    assert (caught.value.span.start, caught.value.span.end) == (0, 1 + 50 * 4 + 6)


# -- texts --------------------------------------------------------------------------------------

TEXTS = {
    r"'a\\'": "a\\",
    r'"a\\"': "a\\",
    r"'\\'": "\\",
    r"'\\\\'": "\\\\",
    r"'a\'b'": "a'b",
    r"'a\\\'b'": r"a\'b",
    r"'C:\dir'": r"C:\dir",
    r"'a\\b'": r"a\\b",
    r"'a\n'": r"a\n",
    r"""'a\"b'""": r"a\"b",
    r'''"a\'b"''': r"a\'b",
    r"""['a\\', 'b']""": ["a\\", "b"],
    r"""'\\' + "'" + '"'""": "\\'\"",
    "''": "",
}


@pytest.mark.parametrize("text", TEXTS)
def test_texts(shared, text):
    assert shared.eval(f"{text};") == TEXTS[text]


@pytest.mark.parametrize("quote", "'\"")
@pytest.mark.parametrize("text", ["", "\\", "'", '"', "\\'", '\\"', "\\\\'", "a\\\\\\", "'\\\"\\"])
def test_each_text_can_be_written(shared, quote, text):
    """Before a quote and at the end backslashes are doubled; quotes get one more."""
    parts = [part + "\\" * (len(part) - len(part.rstrip("\\"))) for part in text.split(quote)]
    assert shared.eval(quote + f"\\{quote}".join(parts) + quote) == text


# -- places -------------------------------------------------------------------------------------

PLACES = {
    "kitchen.tabel;": "tabel",
    "kitchen['tabel'];": "'tabel'",
    "a = 1;\n  a + kitchen.tabel;": "tabel",
    "SELECT kitchen.tabel FROM [1] AS list;": "tabel",
    "SELECT id FROM kitchen WHERE above(kitchen.tabel, this);": "tabel",
    "worlds = [kitchen]; worlds[0].tabel;": "tabel",
}


@pytest.mark.parametrize("program", PLACES)
def test_unknown_entities_have_a_place(kitchen, program):
    with pytest.raises(UnknownNameError, match="did you mean 'table'") as caught:
        kitchen.eval(program)
    span = caught.value.span
    assert caught.value.text[span.start : span.end] == PLACES[program]
    assert "^^^^^" in str(caught.value)


# -- operators as functions ---------------------------------------------------------------------

NAMED = {"add": "+", "sub": "-", "mul": "*", "div": "/", "mod": "%", "pow": "^"}
NAMED |= {"lt": "<", "le": "<=", "eq": "==", "ne": "!=", "ge": ">=", "gt": ">"}


@pytest.mark.parametrize("name", NAMED)
def test_operators_are_functions(shared, name):
    pairs = "FROM [[7, 2], [2, 7], [-3.5, 2], [4, 4]]"
    assert shared.eval(f"SELECT {name}(this[0], this[1]) {pairs} AS list;") == shared.eval(
        f"SELECT this[0] {NAMED[name]} this[1] {pairs} AS list;"
    )
    with pytest.raises(ArgumentError, match=f"{name} takes 2 arguments, not 1"):
        shared.eval(f"{name}(1);")


REPLACED = {**{sign: name for name, sign in NAMED.items()}, "AND": "and", "OR": "or", "XOR": "xor"}


@sampled("sign", REPLACED, every=3)
def test_a_users_function_is_what_an_operator_means(ss, sign):
    name = REPLACED[sign]
    programs = [f"1 {sign} 2;", f"SELECT this {sign} 2 FROM [1, 5] AS list;"]
    programs += [f"SELECT this FROM [1, 5] WHERE 0 {sign} this AS list;", f"1 {f'{sign} 1 ' * 40};"]
    before = [ss.eval(program) for program in programs]
    with pytest.warns(UserWarning, match=f"'{name}' replaces the operator"):
        ss.add_function(name, lambda a, b: [a, b])
    nested = reduce(lambda a, _: [a, 1], range(40), 1)
    if sign in ("<", "<=", ">", ">="):  # `a < b < c` is `a < b AND b < c`
        nested = True
    assert [ss.eval(program) for program in programs] == [[1, 2], [[1, 2], [5, 2]], [1, 5], nested]
    assert ss.eval(f"eval('3 {sign} 4');") == [3, 4]
    ss.del_function(name)
    assert [ss.eval(program) for program in programs] == before


def test_signs_membership_and_negation(ss):
    for name in ("in", "not", "neg"):
        with pytest.warns(UserWarning, match=f"'{name}'"):
            ss.add_function(name, lambda *values: list(values))
    assert ss.eval("[1 IN [2], NOT 3, -4];") == [[[2], 1], [3], [4]]


def test_two_interpreters_mean_different_things(ss):
    with ssduck.Interpreter() as other:
        with pytest.warns(UserWarning, match="'add'"):
            other.add_function("add", lambda a, b: "mine")
        program = "1 + 2;"
        assert (other.eval(program), ss.eval(program), other.eval(program)) == ("mine", 3, "mine")


# -- users' functions in the place of others ----------------------------------------------------

OF_THE_LANGUAGE = ["on", "above", "id", "volume", "count", "sum", "str", "round"]


@pytest.mark.slow
@sampled("name", OF_THE_LANGUAGE, every=4)
def test_a_users_function_replaces(kitchen, name):
    table = "table = SELECT obj FROM kitchen WHERE isKinbody(this) LIMIT 1 AS value;"
    given = "[1]" if name in ("count", "sum") else "1" if name in BUILTINS else "table"
    program = f"{table} SELECT {name}({given}), to({name}({given}), 'b') FROM kitchen LIMIT 1;"
    program = program.replace("(table)", "(table, this)") if name in ("on", "above") else program
    before, helped = kitchen.eval(program), kitchen.help(name)
    with pytest.warns(UserWarning, match=f"your function '{name}' replaces the language's own"):
        kitchen.add_function(name, lambda *_: "mine", "what it does")
    assert kitchen.eval(program) == [{name: "mine", "b": "mine"}]
    assert kitchen.eval(f"SELECT {name} FROM kitchen LIMIT 1 AS list;") == ["mine"]
    assert kitchen.eval(f"{name}(1, 2, 3);") == "mine"
    assert kitchen.help(name).endswith("what it does")
    assert kitchen.help().count(name) == 1
    if name in ("on", "above"):
        text = f'SELECT count(*) FROM kitchen.entities a, kitchen.entities b WHERE "{name}"(a, b)'
        assert kitchen.sql(text).fetchall()[0][0] > 0
    kitchen.del_function(name)
    assert (kitchen.eval(program), kitchen.help(name)) == (before, helped)


@pytest.mark.parametrize(
    "program",
    [
        "SELECT volume FROM kitchen LIMIT 1 AS list;",
        "SELECT k.volume FROM k=kitchen LIMIT 1 AS list;",
        "SELECT k.volume FROM k=kitchen, n=[1] LIMIT 1 AS list;",
        "SELECT volume(this) FROM kitchen WHERE volume == 42 LIMIT 1 AS list;",
        "SELECT volume(this) FROM kitchen WHERE NOT volume < 42 LIMIT 1 AS list;",
        "SELECT k.volume FROM kitchen k WHERE k.volume == 42 LIMIT 1 AS list;",
        "SELECT max(volume) FROM kitchen HAVING min(volume) == 42 AS list;",
        "SELECT volume FROM kitchen GROUP BY volume HAVING volume == 42 LIMIT 1 AS list;",
        "SELECT 42 FROM kitchen ORDER BY volume LIMIT 1 AS list;",
    ],
)
def test_wherever_it_is_named_the_users_function_is_meant(kitchen, program):
    with pytest.warns(UserWarning, match="'volume'"):
        kitchen.add_function("volume", lambda _: 42)
    try:
        found = kitchen.eval(program)
    finally:
        kitchen.del_function("volume")
    assert (found["42"][:1] if isinstance(found, dict) else found) == [42]


@pytest.mark.slow
@pytest.mark.parametrize("name", ["time", "tick"])
def test_what_looks_at_other_ticks_uses_the_languages_own(name):
    with ssduck.load("kitchen") as found:
        program = "table = SELECT obj FROM kitchen WHERE isKinbody(this) LIMIT 1 AS value;"
        program += "holds(above(table, table));"
        found.worlds[0].step()
        before = found.eval(program)
        with pytest.warns(UserWarning, match=name):
            found.add_function(name, lambda *_: "mine")
        assert found.eval(program) == before


def test_operators_without_a_function_are_no_trouble(kitchen):
    program = "SELECT id FROM kitchen WHERE id LIKE 'cup%' AND id IS NOT NULL AS list;"
    before = kitchen.eval(program)
    with pytest.warns(UserWarning, match="'add'"):
        kitchen.add_function("add", lambda a, b: [a, b])
    found = kitchen.eval(program)
    kitchen.del_function("add")
    assert found == before != []


@pytest.mark.slow
def test_a_replaced_relation_with_types_is_sql(kitchen):
    def above(a: ssduck.Entity, b: ssduck.Entity) -> bool:
        return a.name < b.name

    names = kitchen.eval("SELECT id FROM kitchen AS list;")
    program = "SELECT a.id FROM a=kitchen, b=kitchen WHERE above(a.this, b.this) AS list;"
    program = program.replace("a.id", "id(a.this)")
    with pytest.warns(UserWarning, match="'above'"):
        kitchen.add_function("above", above)
    found = kitchen.eval(program)
    kitchen.del_function("above")
    assert found == [a for a in names for b in names if a < b]


def test_functions_of_ones_own_are_removed(ss):
    ss.add_function("mine", lambda: 1)
    ss.addFunction("mine", lambda: 2)  # again, without a word
    assert ss.eval("mine();") == 2
    ss.delFunction("mine")
    for name in ("mine", "count", "no_such"):
        with pytest.raises(UnknownNameError, match=r"no function .* of yours"):
            ss.del_function(name)


def test_the_same_function_replaces_nothing(ss):
    for name, function in (("str", str), ("abs", abs), ("sum", sum), ("count", len)):
        ss.addFunction(name, function)
    assert ss.eval("[str(1), abs(-1)];") == ["1", 1]


# -- what is remembered -------------------------------------------------------------------------


class Counted:
    """A function that counts its calls."""

    def __init__(self, function):
        self.calls = []
        self._function = function

    def __call__(self, *values):
        self.calls.append(values)
        return self._function(*values)


def test_few_distinct_arguments_few_calls(ss):
    half = Counted(lambda n: n // 2)
    ss.add_function("half", half)
    ss.add_variable("many", list(range(10)) * 50)
    assert ss.eval("SELECT half(this) FROM many AS list;") == [n // 2 for n in range(10)] * 50
    assert len(half.calls) == 10
    ss.eval("SELECT half(this) FROM many AS list;")  # another query, another memory
    assert len(half.calls) == 20
    ss.eval("SELECT half(a.this % 3) FROM a=many, b=[1, 2] WHERE half(a.this % 3) == 0 AS list;")
    assert len(half.calls) == 23


ALIKE = [
    [0, 0.0, -0.0, False],
    [1, 1.0, True],
    ["1", 1],
    [[1], [1.0], [True]],
    [math.nan, math.nan],
]


@pytest.mark.parametrize("values", ALIKE)
def test_what_a_function_tells_apart_is_told_apart(ss, values):
    ss.add_function("shown", repr)
    ss.add_variable("values", values * 30)
    assert ss.eval("SELECT shown(this) FROM values AS list;") == list(map(repr, values * 30))


def test_what_a_function_changes_is_its_own(ss):
    def emptied(values):
        return [len(values), values.clear()]

    ss.add_function("emptied", emptied)
    ss.add_variable("lists", [[1, 2], [3], [1, 2]] * 30)
    found = ss.eval("SELECT emptied(this), this FROM lists AS list;")
    assert found[:4] == [[2, None], [1, 2], [1, None], [3]]
    assert found[4:6] == [[2, None], [1, 2]]


def test_errors_are_not_remembered(ss):
    def picky(n):
        if n == 3 and len(asked) < 3:
            asked.append(n)
            raise ValueError("not yet")
        return n

    asked = []
    ss.add_function("picky", picky)
    for _ in range(3):
        with pytest.raises(ssduck.errors.FunctionError, match="not yet"):
            ss.eval("SELECT picky(this) FROM [1, 3] AS list;")
    assert ss.eval("SELECT picky(this) FROM [1, 3] AS list;") == [1, 3]


@pytest.mark.slow
def test_entities_at_other_ticks_are_others():
    with ssduck.load("kitchen") as ss:
        world = ss.call_variable("kitchen")
        height = Counted(lambda e: e.position[2])
        ss.add_function("height", height)
        ss.eval("can = SELECT obj FROM kitchen WHERE id(this) == 'can' AS value;")
        world.step(60)
        now = ss.eval("SELECT height(this) FROM [can, can] AS list;")
        world["can"].move([0, 0, 3], [1, 0, 0, 0])
        then = ss.eval("SELECT height(this) FROM [can, can] AS list;")
        assert (then, len(height.calls)) == ([3.0, 3.0], 2)
        assert now != then
        program = "SELECT height(this), z(this) FROM kitchen{} WHERE id(this) == 'can' AS list;"
        found = ss.eval(program)
        assert found[::2] == found[1::2]
        assert len(set(found)) > 1


@pytest.mark.slow
def test_many_distinct_arguments_are_no_trouble(ss):
    double = Counted(lambda n: 2 * n)
    ss.add_function("double", double)
    ss.add_variable("many", [n + 0.5 for n in range(25_000)])
    assert ss.eval("sum(SELECT double(this) FROM many AS list);") == 2 * sum(
        n + 0.5 for n in range(25_000)
    )
    assert len(double.calls) == 25_000


def test_what_happens_happens_each_time(ss, capsys):
    ss.add_function("one", lambda n: 1)
    ss.eval("SELECT print(one(this)) FROM [1, 1, 1] AS list;")
    assert capsys.readouterr().out == "1\n1\n1\n"


# -- values of the wrong kind -------------------------------------------------------------------

VALUES = {
    "text": "'abc'",
    "format": "'%1000000000d'",
    "number": "-1",
    "real": "0.5",
    "huge": "(10 ^ 5000)",
    "infinite": "inf",
    "not a number": "nan",
    "nothing": "nothing",
    "flag": "True",
    "empty": "[]",
    "list": "[1, 'a', [2]]",
    "dict": "dict",
    "entity": "entity",
    "world": "kitchen",
}


def _counted(function):
    @wraps(function)
    def call(*arguments):
        return function(*arguments)

    return call


class _Named:
    def method(self, a, b=1):
        return a, b


@pytest.mark.parametrize(
    ("call", "expected"),
    [
        (lambda: 0, (0, 0)),
        (lambda a, b: 0, (2, 2)),
        (lambda a, b=1, *, c=2: 0, (1, 2)),
        (lambda a, /, b, *others: 0, (2, None)),
        (lambda *, a=1, **others: 0, (0, 0)),
        (_counted(lambda a, b=1: 0), (1, 2)),
        (partial(lambda a, b: 0, 1), (1, 1)),
        (_Named().method, (1, 2)),
        (_Named.method, (2, 3)),
        (print, (0, None)),
    ],
)
def test_functions_take_as_many_arguments_as_python_says(call, expected):
    function = Function.of("own", call, "Is a function.")
    assert (function.min_arguments, function.max_arguments) == expected


def arities(name):
    if name in RELATIONS:
        return sorted(RELATIONS[name].expressions)
    function = BUILTINS[name]
    most = function.min_arguments + 1 if function.max_arguments is None else function.max_arguments
    return range(function.min_arguments, most + 1)


@pytest.fixture(scope="module")
def wrong(kitchen):
    kitchen.add_variable("inf", math.inf)
    kitchen.add_variable("nan", math.nan)
    kitchen.add_variable("nothing", None)
    kitchen.add_variable("dict", {"a": 1})
    kitchen.add_variable("entity", kitchen.call_variable("kitchen")["table"])
    return kitchen


@sampled("name", [*BUILTINS], every=3)
def test_functions_of_values_that_they_do_not_take(wrong, name):
    """A value, or an error of the language with the function's name and place."""
    for count in arities(name):
        for value in VALUES.values():
            others = [["1"] * count, [value] * count]
            for arguments in others:
                arguments[0] = value
                call = f"{name}({', '.join(arguments)})"
                check(wrong, f"{call};", name)
                check(wrong, f"SELECT {call} FROM [1] AS list;", name)


@sampled("name", [*RELATIONS], every=4)
def test_relations_of_values_that_they_do_not_take(wrong, name):
    for count in arities(name):
        for value in VALUES.values():
            for arguments in ([value] * count, ["entity"] * (count - 1) + [value]):
                check(wrong, f"{name}({', '.join(arguments)});", name)


@pytest.mark.parametrize("axis", ["-1", "3", "tick(this) - tick(this) - 1"])
def test_an_axis_that_there_is_not(kitchen, axis):
    with pytest.raises(ArgumentError, match="linearVelocity: axis must be 0, 1 or 2"):
        kitchen.eval(f"SELECT linearVelocity(this, {axis}) FROM kitchen AS list;")


def check(ss, program, name):
    try:
        ss.eval(program)
    except SelectScriptError as error:
        assert error.span is not None, program
        foreign = ("TypeError", "ValueError", "OverflowError", "ZeroDivisionError", "domain")
        assert not any(word in error.message for word in foreign), (program, error.message)
        if isinstance(error, ArgumentError):
            assert name in error.message, (program, error.message)


SIGNS = [*NAMED.values(), "IN", "AND", "OR", "XOR"]


@sampled("sign", SIGNS, every=4)
def test_operators_of_values_that_they_do_not_take(wrong, sign):
    for left in VALUES.values():
        for right in (*VALUES.values(), "1000000000000"):
            check(wrong, f"{left} {sign} {right};", sign)


@pytest.mark.parametrize("left", ["'%1000000000d'", "'%s'", "''", "'%(a)s'"])
@pytest.mark.parametrize("right", ["1", "0.5", "[1]", "dict", "entity"])
def test_texts_have_no_remainder(wrong, left, right):
    for program in (f"{left} % {right};", f"SELECT {left} % {right} FROM kitchen AS list;"):
        with pytest.raises(ArgumentError, match="% does not take a text") as caught:
            wrong.eval(program)
        assert "%" in program[caught.value.span.start : caught.value.span.end]


@pytest.mark.parametrize(
    ("program", "word", "suggestion"),
    [
        ("SELEC id FROM kitchen;", "SELEC", "SELECT"),
        ("selct * FROM kitchen;", "selct", "SELECT"),
        ("SLECT (1) FROM kitchen;", "SLECT", "SELECT"),
        ("1; SELEC 2;", "SELEC", "SELECT"),
        ("EXPLIAN SELECT id FROM kitchen;", "EXPLIAN", "EXPLAIN"),
        ("EXPLAIN SELEC id FROM kitchen;", "SELEC", "SELECT"),
    ],
)
def test_a_statement_whose_first_word_is_misspelt_has_the_keyword(program, word, suggestion):
    with pytest.raises(ParseError, match=f"'{word}' begins no statement; did you") as caught:
        parse(program)
    error = caught.value
    assert error.suggestions == (suggestion,)
    assert program[error.span.start : error.span.end] == word


@pytest.mark.parametrize("program", ["seleced = 2 3;", "selects);", "DELETE FROM x;", "foo bar;"])
def test_other_mistakes_are_told_where_they_are(program):
    with pytest.raises(ParseError, match=r"expected .;."):
        parse(program)
