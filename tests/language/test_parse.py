"""Text to tree: precedence, clauses, places, and what is no program."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from ssduck.errors import ParseError, SelectScriptError
from ssduck.language.ast import (
    Assignment,
    Binary,
    Call,
    If,
    Index,
    ListLiteral,
    Literal,
    Name,
    Node,
    Query,
    This,
    TimeIndex,
    Unary,
    UnboundedHorizon,
)
from ssduck.language.parser import parse


def shown(node: Node) -> str:
    """A tree with every operation in parentheses."""
    match node:
        case Literal(value=value):
            return repr(value)
        case Name(name=name):
            return name
        case This(alias=alias):
            return f"{alias}.this" if alias else "this"
        case TimeIndex(name=name, age=age):
            return f"{name}{{{shown(age) if age else ''}}}"
        case ListLiteral(items=items):
            return "[" + ", ".join(map(shown, items)) + "]"
        case Call(name=name, arguments=arguments):
            return f"{name}({', '.join(map(shown, arguments))})"
        case Index(base=base, indices=indices):
            return f"{shown(base)}[{', '.join(map(shown, indices))}]"
        case Unary(operator=operator, operand=operand):
            return f"({operator} {shown(operand)})"
        case Binary(operator=operator, left=left, right=right):
            return f"({shown(left)} {operator} {shown(right)})"
        case UnboundedHorizon():
            return ""
        case Assignment(name=name, horizon=None, value=value):
            return f"{name}={shown(value)}"
        case Assignment(name=name, horizon=horizon, value=value):
            return f"{name}{{{shown(horizon)}}}={shown(value)}"
        case If(condition=condition, then=then, otherwise=otherwise):
            parts = "; ".join(
                ", ".join(map(shown, part)) for part in ((condition,), then, otherwise)
            )
            return f"IF({parts})"
        case Query():
            return "<query>"
    raise AssertionError(node)


# (text, tree)
EXPRESSIONS = [
    ("1+2*3-4/5.", "((1 + (2 * 3)) - (4 / 5.0))"),
    ("1-2-3", "((1 - 2) - 3)"),
    ("2^3^2", "((2 ^ 3) ^ 2)"),
    ("-2^2", "((- 2) ^ 2)"),
    ("- -x", "(- (- x))"),
    ("a or b xor c and not d in e", "(a OR (b XOR (c AND (NOT (d IN e)))))"),
    ("not not a", "(NOT (NOT a))"),
    ("a == b != c", "(a == (b != c))"),
    ("a != b >= c > d <= e < f", "(a != ((((b >= c) AND (c > d)) AND (d <= e)) AND (e < f)))"),
    ("a < b < c", "((a < b) AND (b < c))"),
    ("a < b <= c", "((a < b) AND (b <= c))"),
    ("0 <= a + 1 < b * 2 OR c", "(((0 <= (a + 1)) AND ((a + 1) < (b * 2))) OR c)"),
    ("(a < b) < c", "((a < b) < c)"),
    ("a < (b < c)", "(a < (b < c))"),
    ("a < b == c < d", "((a < b) == (c < d))"),
    ("a < b + c", "(a < (b + c))"),
    ("(a + b) * c", "((a + b) * c)"),
    ("a == (b == c)", "(a == (b == c))"),
    ("x[1]", "x[1]"),
    ("x[1, 2][3]", "x[1, 2, 3]"),
    ("this[0].key", "this[0, 'key']"),
    ("e.this.key", "e.this['key']"),
    ("e.this", "e.this"),
    ("this", "this"),
    ("THIS", "this"),
    ("[1, 'a', \"b\", [True, FALSE]]", "[1, 'a', 'b', [True, False]]"),
    ("[]", "[]"),
    ("v{5.0}", "v{5.0}"),
    ("v{}", "v{}"),
    ("v{-2.0}", "v{(- 2.0)}"),
    ("f()", "f()"),
    ("f(a, g(b))", "f(a, g(b))"),
    (".5 + 5. + 1e3 + 2.5e-3", "(((0.5 + 5.0) + 1000.0) + 0.0025)"),
    ("IF(a; b, c; d)", "IF(a; b, c; d)"),
    ("IF(a; b)", "IF(a; b; )"),
    ("iff", "iff"),
    ("a = b = 3", "a=b=3"),
    ("(a = 3) + 1", "(a=3 + 1)"),
    ("a{5.0} = 3", "a{5.0}=3"),
    ("a{} = b = 3", "a{}=b=3"),
    ("a{2 * h} = b{h{}} = 3", "a{(2 * h)}=b{h{}}=3"),
    ("a{b{1}} + 2", "(a{b{1}} + 2)"),
    ("[1,2] == SELECT x FROM y AS list", "([1, 2] == <query>)"),
    ("'it\\'s'", '"it\'s"'),
    ("'//' + '#' + '/*'", "(('//' + '#') + '/*')"),
    ("1 // one\n + 2 # two\n + /* three \n */ 3", "((1 + 2) + 3)"),
    ("größe + 名前", "(größe + 名前)"),
]


@pytest.mark.parametrize(("text", "tree"), EXPRESSIONS)
def test_expressions(text, tree):
    (statement,) = parse(text + ";").statements
    assert shown(statement) == tree


def test_all_clauses_of_a_query():
    (query,) = parse(
        "select a.this, f(b.this), name, to(x(a.this), 'n') from a=k, b=(SELECT obj FROM k AS list), k, [1,2] "
        "where a.this != b.this "
        "start with s = 1, t = [2] connect by no cycle unique memorize 3 maximum 4 s = s + 1 stop with s > 3 "
        "group by id(a.this), name having count(this) > 1 "
        "order by x(a.this) desc, y descending, z asc, w ascending, v "
        "limit 10 as thing(1, 'two', three=3);"
    ).statements
    assert isinstance(query, Query)
    assert [shown(item) for item in query.items] == [
        "a.this",
        "f(b.this)",
        "name",
        "to(x(a.this), 'n')",
    ]
    assert [source.alias for source in query.sources] == ["a", "b", "k", None]
    assert shown(query.where) == "(a.this != b.this)"
    recursion = query.recursion
    assert [shown(part) for part in recursion.start] == ["s=1", "t=[2]"]
    assert (recursion.no_cycle, recursion.unique) == (True, True)
    assert (shown(recursion.memorize), shown(recursion.maximum)) == ("3", "4")
    assert [shown(part) for part in recursion.step] == ["s=(s + 1)"]
    assert shown(recursion.stop) == "(s > 3)"
    assert [shown(key) for key in query.group] == ["id(a.this)", "name"]
    assert shown(query.having) == "(count(this) > 1)"
    assert [(shown(key.value), key.descending) for key in query.order] == [
        ("x(a.this)", True),
        ("y", True),
        ("z", False),
        ("w", False),
        ("v", False),
    ]
    assert shown(query.limit) == "10"
    adapter = query.adapter
    assert (adapter.name, [shown(a) for a in adapter.arguments]) == ("thing", ["1", "'two'"])
    assert [shown(argument) for argument in adapter.named] == ["three=3"]


def test_statements_in_order_and_empty_programs():
    assert [shown(node) for node in parse("a = 1; ; b; c").statements] == ["a=1", "b", "c"]
    assert parse("").statements == ()
    assert parse(" // nothing\n ; /* at all */ ;").statements == ()


# (text, the offending text, a word of the message)
MISTAKES = [
    ("1 +;", ";", "expression"),
    ("SELECT id FORM kitchen;", "FORM", "FROM"),
    ("SELECT id FROM kitchen WHERE (1;", ";", "')'"),
    ("SELECT FROM kitchen;", "FROM", "expression"),
    ("SELECT id, FROM kitchen;", "FROM", "expression"),
    ("SELECT id FROM kitchen ORDER id;", "ORDER", "';'"),
    ("SELECT id FROM kitchen AS;", ";", "result form"),
    ("SELECT id FROM kitchen AS list(1;", ";", "')'"),
    ("SELECT * id FROM kitchen;", "id", "FROM"),
    ("f(z + 1 = 'x');", "=", "'=='"),
    ("SELECT id FROM kitchen STOP WITH a;", "STOP", "';'"),
    ("SELECT id FROM kitchen START WITH a=1;", ";", "CONNECT BY"),
    ("SELECT id FROM kitchen CONNECT BY a=1;", ";", "STOP WITH"),
    ("SELECT id FROM a{2} = kitchen;", "{", "a source has no history"),
    (
        "SELECT this FROM k START WITH a{2} = 1 CONNECT BY a = 2 STOP WITH 1;",
        "{",
        "a state variable has no history",
    ),
    ("SELECT this FROM k CONNECT BY a{} = 2 STOP WITH 1;", "{", "a state variable has no history"),
    ("SELECT this FROM k AS value(default{} = 2);", "{", "an argument has no history"),
    ("v{5 = 3;", "=", "'=='"),
    ("v{} 3;", "3", "';'"),
    ("a b;", "b", "';'"),
    ("'abc", "'abc", "never closed"),
    ('x = "abc;\ny = 2;', '"abc;\ny = 2;', "never closed"),
    ("1; /* abc", "/* abc", "never closed"),
    ("a == b = 3;", "=", "'=='"),
    ("1.5.2;", "2", "key"),
    ("1e;", "1e", "number"),
    ("[1, 2;", ";", "']'"),
    ("f(1;", ";", "')'"),
    ("x[];", "]", "expression"),
    ("IF(a, b);", ",", "';'"),
    ("IF(a; b; c;", ";", "')'"),
    ("@;", "@", "expression"),
    ("a ? b;", "?", "';'"),
    ("and;", "and", "expression"),
    ("a = ;", ";", "expression"),
    ("v{1;", ";", "'}'"),
]


@pytest.mark.parametrize(("text", "offending", "word"), MISTAKES)
def test_mistakes_say_where(text, offending, word):
    with pytest.raises(ParseError) as caught:
        parse(text)
    error = caught.value
    assert text[error.span.start : error.span.end] == offending
    assert word in error.message
    lines = str(error).splitlines()
    assert f"line {error.line}, column {error.column}" in lines[1]
    assert lines[3].strip("\t ^") == ""


def test_a_mistake_at_the_end_points_behind_the_text():
    with pytest.raises(ParseError) as caught:
        parse("SELECT id FROM kitchen WHERE ")
    assert (caught.value.line, caught.value.column) == (1, 29)
    assert "end of the text" in caught.value.message


@pytest.mark.parametrize(
    "text",
    [
        "(" * 5000,
        "[" * 5000,
        "- " * 3000 + "(" * 3000,
        "NOT " * 3000 + "a",
        "f(" * 3000,
        "a = " * 3000,
        "- " * 100 + "1",
        "+ - " * 50 + "1",
    ],
)
def test_deep_nesting_is_an_error_and_no_crash(text):
    with pytest.raises(ParseError):
        parse(text)


@pytest.mark.parametrize(
    "text", ["- " * 40 + "1", "x" + "[0].key" * 20, "[x[0], " * 20 + "1" + "]" * 20]
)
def test_signs_and_indices_beside_each_other_are_not_nested(text):
    (statement,) = parse(f"[{', '.join([text] * 30)}];").statements
    assert len(statement.items) == 30


@given(st.text(alphabet="ab1.'\"()[]{}=<>!+-*/%^;,# \n\tSELECTFROMhis", max_size=60))
def test_any_text_is_a_program_or_a_parse_error(text):
    try:
        parse(text)
    except ParseError as error:
        assert error.line is not None
        assert str(error)


@pytest.mark.slow
@given(st.text(max_size=40))
def test_any_unicode_is_a_program_or_a_parse_error(text):
    try:
        parse(text)
    except SelectScriptError as error:
        assert str(error)


SPANNED = (
    "table = SELECT obj, volume(this) FROM k=kitchen WHERE id(this) == 'table' ORDER BY x AS list;"
)


def test_every_node_knows_its_text():
    """The text of a node, parsed again, is that node."""
    for statement in parse(SPANNED).statements:
        for node in statement.walk():
            part = SPANNED[node.span.start : node.span.end]
            if isinstance(node, Name | Call | Literal | Binary | This | Query | Assignment):
                (again,) = parse(part).statements
                assert shown(again) == shown(node)


@pytest.mark.parametrize("word", ["WHY", "EXPLAIN"])
def test_a_prefix_is_told_from_a_name_by_what_follows(word):
    for text in ("z(a) > 1;", "1 < 2;", "(1 < 2) AND z(a) > 1;", "-z(a) < 0;", "'a' == id(a);"):
        program = parse(f"{word.lower()} {text}")
        assert program.explain == word
        assert str(program.statements) == str(parse(f"{' ' * len(word)} {text}").statements)
    for text in (f"{word}(1);", f"{word} - 1;", f"{word} = 1;", f"{word}[0];", f"{word} < 1;"):
        assert not parse(text).explain
    for text in (f"a = 1; {word} z(a) > 1;", f"a = 1; {word} 'x' == a;"):
        with pytest.raises(ParseError, match=f"{word} begins a program"):
            parse(text)
    with pytest.raises(ParseError):
        parse(f"{word} -")
