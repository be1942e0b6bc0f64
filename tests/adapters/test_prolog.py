"""Relations as clauses: AS prolog, read by SWI-Prolog, and AS asp, read by clingo."""

import json
import math
import re
import shutil
import subprocess
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

import ssduck
from ssduck.adapters.logic import _asp_term, _atom, _term
from ssduck.errors import ArgumentError, SelectScriptError, UnknownNameError
from tests.support.cases import sampled
from tests.support.timing import HANGS

PRINTED = (
    (Path(__file__).parents[1] / "data" / "clauses.txt")
    .read_text(encoding="utf-8")
    .split("\n")[:-1]
)
SWIPL = shutil.which("swipl")
needs_swipl = pytest.mark.skipif(SWIPL is None, reason="SWI-Prolog (swipl) is not installed")

# The query of the tutorial's section 10.3, as printed.
QUERY = "SELECT  above(a.this, b.this),                    \
                isEnabled(a.this),                        \
                volume(a.this),                           \
                position(a.this),                         \
                isRobot(a.this),                          \
                isKinbody(a.this)                         \
         FROM a=kitchen, b=kitchen                        \
         WHERE not (isSensor(a.this) or isSensor(b.this)) \
         AS prolog;"


@pytest.fixture(params=[False, True], ids=["as SQL", "row by row"])
def plain(request):
    with ssduck.Interpreter(row_by_row=request.param) as ss:
        ss.add_function("given", lambda *values: values[-1])
        ss.add_function("is2", lambda value: value == 2)
        yield ss


def swipl(folder, clauses, goal):
    """What SWI-Prolog prints that has read the clauses."""
    program = folder / "program.pl"
    text = "".join(f"{clause}.\n" for clause in clauses)
    program.write_text(f":- encoding(utf8).\n{text}", encoding="utf-8")
    done = subprocess.run(
        [
            SWIPL,
            "-q",
            "-g",
            f"set_stream(user_output, encoding(utf8)), {goal}",
            "-t",
            "halt",
            program,
        ],
        capture_output=True,
        check=False,
        timeout=HANGS,
    )
    assert (done.returncode, done.stderr.decode()) == (0, "")
    return done.stdout.decode()


# -- the tutorial ------------------------------------------------------------------------------

NUMBER = re.compile(r"-?\d+\.?\d*(?:e[+-]?\d+)?(?![\w])")


def parted(clause):
    """A clause without its fractions, and these: `cup_58a2` has none."""
    head, bracket, rest = clause.partition(",[") if ",[" in clause else clause.rpartition(",")
    found = NUMBER.findall(rest) if bracket else []
    if not found or not re.fullmatch(r"[\d\s,.e\[\])-]*", rest):
        return clause, []
    return head, [float(number) for number in found]


@pytest.mark.slow
def test_the_clauses_that_the_tutorial_prints(kitchen):
    """Beside them are those of the robots' volumes, 0.0, which Python holds to be False."""
    found = kitchen.eval(QUERY)
    volumes = [
        clause for clause in found if clause.startswith("volume(") and clause.endswith(",0.0)")
    ]
    assert volumes == [
        f"volume({name},0.0)" for name in ("barrett_4918", "cooker", "fridge", "roomba_625x")
    ]
    rest = [clause for clause in found if clause not in volumes]
    assert [parted(clause)[0] for clause in rest] == [parted(clause)[0] for clause in PRINTED]
    for ours, printed in zip(rest, PRINTED, strict=True):
        assert parted(ours)[1] == pytest.approx(parted(printed)[1], rel=1e-4, abs=1e-6), printed
    assert sum(bool(parted(clause)[1]) for clause in rest) == 29 + 25


@pytest.mark.slow
def test_it_is_one_query(kitchen):
    sent = []
    with ssduck.Interpreter(tracer=sent.append) as ss:
        ss.add_variable("kitchen", kitchen.call_variable("kitchen"))
        del sent[:]
        assert ss.eval(QUERY) == kitchen.eval(QUERY)
        assert len([text for text in sent if "above" in text or "xmin" in text]) == 1


@pytest.mark.slow
@needs_swipl
def test_swi_prolog_answers_as_printed(kitchen, tmp_path):
    clauses = kitchen.eval(QUERY)
    goal = (
        "findall(X, above(table, X), Xs), print(Xs), nl,"
        "findall(Obj-V, (volume(Obj, V), V > 1.0), Vs), print(Vs), nl,"
        "findall(P, position(_, P), Ps), print(Ps), nl"
    )
    above, volumes, positions = swipl(tmp_path, clauses, goal).splitlines()
    assert above == "[cup_58a2,cup_905a,cup_b6af,cup_d441,plate_496f,plate_835a,plate_fa76]"
    name, volume = volumes.strip("[]").split("-")
    assert (name, float(volume)) == ("kitchen", pytest.approx(5.32756277229, abs=1e-6))
    printed = [parted(clause)[1] for clause in PRINTED if clause.startswith("position(")]
    assert len(printed) == 29
    found = json.loads(positions)
    assert len(found) == 29
    for ours, theirs in zip(found, printed, strict=True):
        assert ours == pytest.approx(theirs, abs=1e-6)


# -- columns -----------------------------------------------------------------------------------

COLUMNS = [
    # columns, sources, clauses
    ("is2", "[1, 2]", ["is2(2)"]),
    ("given(this, 'x')", "[1]", ["given(1,x,x)"]),
    ("given", "[5]", ["given(5,5)"]),
    ("to(given, 'g')", "[5]", ["g(5,5)"]),
    ("to(is2(this), 'two')", "[2]", ["two(2)"]),
    ("to(this + 1, 'next')", "[5]", ["next(5,6)"]),
    ("to(3, 'three')", "[5]", ["three(5,3)"]),
    ("to(a.this + b.this, 'sum')", "a=[1], b=[2]", ["sum(1,2,3)"]),
    ("to(b.this > 1, 'large')", "a=[1, 2], b=[2]", ["large(2)"]),
    ("to(3, 'three')", "a=[1], b=[2]", ["three(3)"]),
    ("to(1 == 1, 'so')", "a=[1], b=[2]", ["so"]),
    ("given(a.this, b.this, True)", "a=[1], b=[2]", ["given(1,2,true)"]),
    ("given(this, 1), given(this, 1)", "[1, 1, 0]", ["given(0,1,1)", "given(1,1,1)"]),
    ("given(this, 0), given(this, 0.0)", "[1]", ["given(1,0,0)", "given(1,0.0,0.0)"]),
    ("to(given(this), str(this))", "[1, 2]", ["'1'(1,1)", "'2'(2,2)"]),
    ("given([this, [True, False]], 'A b')", "[1]", ["given([1, [true, false]],'A b','A b')"]),
    ("given(this, [])", "[1]", ["given(1,[],[])"]),
    ("given(this)", "[]", []),
]


@sampled(("columns", "sources", "clauses"), COLUMNS, every=3)
def test_columns_become_clauses(plain, columns, sources, clauses):
    assert plain.eval(f"SELECT {columns} FROM {sources} AS prolog;") == clauses


REFUSED = [
    ("SELECT this FROM [1] AS prolog;", ArgumentError, "to\\(…, 'name'\\)", "this"),
    ("SELECT this + 1 FROM [1] AS asp;", ArgumentError, "to\\(…, 'name'\\)", "this + 1"),
    ("SELECT * FROM [1] AS prolog;", ArgumentError, "SELECT \\* selects no relations", None),
    ("SELECT given FROM a=[1], b=[2] AS prolog;", ArgumentError, "given\\(a.this\\)", "given"),
    ("SELECT givn(this) FROM [1] AS prolog;", UnknownNameError, "'given'", "givn"),
    ("SELECT to(given(this), 3) FROM [1] AS prolog;", ArgumentError, "must be a text", None),
    ("SELECT given(this) FROM rows AS prolog;", ArgumentError, "is no term", "prolog"),
    ("SELECT to(given(this), 'Up') FROM [1] AS asp;", ArgumentError, "a predicate's name", "asp"),
    ("SELECT given(this, 0.5) FROM [1] AS asp(scale=0);", ArgumentError, "above 0", "asp(scale=0)"),
    (
        "SELECT given(this, 3.0) FROM [1] AS asp(scale=10^9);",
        ArgumentError,
        "32 bits",
        "asp(scale=10^9)",
    ),
]


@pytest.mark.parametrize(("program", "error", "message", "place"), REFUSED)
def test_what_is_no_clause(plain, program, error, message, place):
    plain.add_variable("rows", [{"a": 1}])
    with pytest.raises(error, match=message) as caught:
        plain.eval(program)
    if place is not None:
        span = caught.value.span
        assert program[span.start : span.end] == place


def test_clauses_of_past_worlds_and_groups(kitchen):
    past = "SELECT isRobot FROM kitchen{0.0} GROUP BY type AS prolog;"
    assert kitchen.eval(past) == {
        "sensor": [],
        "robot": [f"isRobot({n})" for n in ("barrett_4918", "cooker", "fridge", "roomba_625x")],
        "kinbody": [],
    }


def test_unknown_results_are_left_out(plain):
    plain.add_variable("rows", [None, 1])
    assert plain.eval("SELECT given(1, this) FROM rows AS prolog;") == ["given(1,1,1)"]
    assert plain.eval("SELECT given(this, 2) FROM rows AS prolog;") == [
        "given(1,2,2)",
        "given(null,2,2)",
    ]


# -- terms -------------------------------------------------------------------------------------

TERMS = [
    ("cup_58a2", "cup_58a2"),
    ("Cup", "'Cup'"),
    ("625x", "'625x'"),
    ("_x", "'_x'"),
    ("", "''"),
    ("[]", "'[]'"),
    ("ärger", "'ärger'"),
    ("it's", "'it\\'s'"),
    ("a\\b", "'a\\\\b'"),
    ("a\nb\tc", "'a\\nb\\tc'"),
    ("\0\x7f\u2028", "'\\x0\\\\x7f\\\\x2028\\'"),
    (True, "true"),
    (None, "null"),
    (-3, "-3"),
    (2**70, "1180591620717411303424"),
    (1e-05, "1.0e-05"),
    (1.5e300, "1.5e+300"),
    (1e22, "1.0e+22"),
    (-0.0, "-0.0"),
    (0.1, "0.1"),
    (math.inf, "1.0Inf"),
    (-math.inf, "-1.0Inf"),
    (math.nan, "1.5NaN"),
    ([1, [2.0, "a"], []], "[1, [2.0, a], []]"),
]


@pytest.mark.parametrize(("value", "text"), TERMS)
def test_terms(value, text):
    assert _term(value) == text


def test_letters_that_prolog_does_not_know():
    with pytest.raises(ArgumentError, match="no letter that Prolog knows"):
        _atom("\ud800")


letters = st.text(st.characters(codec="utf-8")) | st.text("aZ_9'\\\"\n\t\r .[]{}%é\0\x01\u2028")
numbers = st.integers(-(2**80), 2**80) | st.floats()


@pytest.mark.slow
@needs_swipl
def test_swi_prolog_reads_what_was_meant(tmp_path):
    """Many texts and numbers at once, told as the numbers of their letters, and exactly."""
    texts = ["is", "mod", "dynamic", "[]", "{}", "!", ";", ",", "|", ".", "", "nan", "inf"]
    values = []

    @given(letters, numbers)
    def gathered(text, number):
        texts.append(text)
        values.append(number)

    gathered()
    clauses = [f"t({i},{_atom(text)})" for i, text in enumerate(texts)]
    clauses += [
        f"{_atom(text)}({i})"
        for i, text in enumerate(texts)
        if f"x{text}".isidentifier() and text not in RESERVED
    ]
    clauses += [f"n({i},{_term(value)})" for i, value in enumerate(values)]
    goal = (
        "forall(t(I, A), (atom(A), atom_codes(A, Cs), print(I-Cs), nl)), print(end), nl,"
        "forall(n(I, N), (number(N), (float(N) -> format('~w ~15|~q~n', [I, N]) ; format('~w ~d~n', [I, N]))))"
    )
    told, _, counted = swipl(
        tmp_path,
        [":- discontiguous(t/2), discontiguous(n/2)", ":- style_check(-discontiguous)", *clauses],
        goal,
    ).partition("end\n")
    for line, text in zip(told.splitlines(), texts, strict=True):
        assert json.loads(line.partition("-")[2]) == [ord(letter) for letter in text]
    for line, value in zip(counted.splitlines(), values, strict=True):
        read = line.split()[1].replace("1.0Inf", "inf").replace("1.5NaN", "nan")
        found = int(read) if isinstance(value, int) else float(read)
        assert found == value or (math.isnan(found) and math.isnan(value))
        assert math.copysign(1, found) == math.copysign(1, value) or math.isnan(value)


# Built-in predicates, which a program does not define.
RESERVED = {"is", "dynamic"}


# -- clingo ------------------------------------------------------------------------------------

FACTS = [
    ("cup_58a2", "cup_58a2"),
    ("not", '"not"'),
    ("Cup", '"Cup"'),
    ('a"b\\c\nd', '"a\\"b\\\\c\\nd"'),
    (3, "3"),
    (2**31 - 1, "2147483647"),
    (2**31, '"2147483648"'),
    (-(2**31), "-2147483648"),
    (-(2**31) - 1, '"-2147483649"'),
    (0.25, '"0.25"'),
    (math.nan, '"nan"'),
    (True, "true"),
    (None, "null"),
    ([1.5, "x"], '("1.5",x)'),
    ([1], "(1,)"),
    ([], "()"),
]


@pytest.mark.parametrize(("value", "text"), FACTS)
def test_terms_of_clingo(value, text):
    assert _asp_term(value, None) == text


@pytest.mark.parametrize(
    ("value", "scale", "text"),
    [
        (0.42, 1000, "420"),
        (-0.0006, 1000, "-1"),
        ([1.0, 2], 10, "(10,2)"),
        (2147483.647, 1000, "2147483647"),
    ],
)
def test_scaled_terms(value, scale, text):
    assert _asp_term(value, scale) == text


@pytest.mark.parametrize("value", [2147483.6485, math.inf, math.nan])
def test_what_does_not_fit_when_scaled(value):
    with pytest.raises(ArgumentError, match="no integer of 32 bits"):
        _asp_term(value, 1000)


@pytest.mark.slow
@given(st.text(st.characters(codec="utf-8", exclude_characters="\0")) | st.integers())
def test_clingo_reads_what_was_meant(value):
    clingo = pytest.importorskip("clingo")
    symbol = clingo.parse_term(_asp_term(value, None))
    if symbol.type == clingo.SymbolType.Number:
        assert symbol.number == value
    elif symbol.type == clingo.SymbolType.String:
        assert symbol.string == str(value)
    else:
        assert (symbol.name, symbol.arguments) == (value, [])


@pytest.mark.parametrize("text", ["\0", "\ud800"])
def test_letters_that_clingo_does_not_know(text):
    with pytest.raises(SelectScriptError, match="letters that clingo does not know"):
        _asp_term(text, None)


@pytest.mark.slow
def test_clingo_answers(kitchen):
    clingo = pytest.importorskip("clingo")
    facts = kitchen.eval(QUERY.replace("AS prolog", "AS asp(scale=1000)"))
    assert len(facts) == len(PRINTED) + 4
    control = clingo.Control()
    control.add("base", [], "\n".join(facts))
    control.add(
        "base", [], "high(X) :- above(table, X), position(X, (_, _, Z)), Z > 900. #show high/1."
    )
    control.ground([("base", [])])
    models = []
    control.solve(on_model=lambda model: models.append({str(s) for s in model.symbols(shown=True)}))
    on_table = {n for n in PRINTED if n.startswith("above(table")}
    assert models == [{n.replace("above(table,", "high(") for n in on_table}]
