"""Defines the result forms of logic programs: Prolog clauses and facts for clingo.

`SELECT above(a.this, b.this)` becomes `SELECT to([a.this, b.this, above(a.this, b.this)],
'above')`, so that one query returns all parts of a clause.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, TypeAlias

from ssduck import validation
from ssduck.adapters.base import Selection, form
from ssduck.adapters.columns import plain_value
from ssduck.errors import ArgumentError
from ssduck.formatting import short_repr, type_in_words
from ssduck.language import ast
from ssduck.language.analysis import aliases_of, free_aliases
from ssduck.language.operators import size_of


@dataclass(frozen=True)
class Clause:
    """A relation, its arguments and its result."""

    relation: str
    arguments: Sequence[Any]
    result: Any


def with_arguments(query: ast.Query) -> ast.Query:
    """Returns the query with each column replaced by a list of arguments and result."""
    if not query.items:
        raise ArgumentError(
            "SELECT * selects no relations; select isRobot(this), say", span=query.span
        )
    return replace(query, items=tuple(_item_with_arguments(item, query) for item in query.items))


def clauses(selection: Selection) -> Iterator[Clause]:
    """Yields the clauses of a query of `with_arguments`, also those that are false or unknown."""
    rows = selection.read()
    names = rows.names if isinstance(rows.names, list) else [rows.names] * len(rows.values)
    for row_names, row in zip(names, rows.values, strict=True):
        for name, (*arguments, result) in zip(row_names, row, strict=True):
            validation.text(name, "the name of a relation must be a text")
            selection.charge(len(name) + sum(map(size_of, (*arguments, result))))
            yield Clause(name, arguments, result)


def _item_with_arguments(item: ast.Node, query: ast.Query) -> ast.Node:
    span = item.span
    match item:
        case ast.Call(name="to", arguments=(value, name)):
            pass
        case ast.Call(name=relation) | ast.Name(name=relation) if relation != "to":
            value, name = item, ast.Literal(span, relation)
        case _:
            raise ArgumentError(
                "this column is no relation, so the clause has no name; give it one by "
                "to(…, 'name')",
                span=span,
            )
    arguments = (*_arguments(value, query), value)
    return ast.Call(span, "to", (ast.ListLiteral(span, arguments), name), span)


def _arguments(value: ast.Node, query: ast.Query) -> tuple[ast.Node, ...]:
    """Returns the arguments of a relation; of another expression, the sources that it mentions.

    A bare name and an expression over a single source have `this`.
    """
    match value:
        case ast.Call(arguments=arguments):
            return arguments
        case ast.Name(span=span, name=name) if len(query.sources) > 1:
            raise ArgumentError(
                f"with several sources, name the argument: {name}(a.this)", span=span
            )
    if isinstance(value, ast.Name) or len(query.sources) == 1:
        return (ast.This(value.span, None),)
    mentioned = free_aliases(value)
    return tuple(ast.This(value.span, a) for a in aliases_of(query) if a in mentioned)


Term: TypeAlias = Callable[[Any], str]


def _clause_texts(selection: Selection, functor: Term, term: Term) -> list[str]:
    """Returns the texts of clauses that hold, sorted and without repetitions."""
    texts: set[str] = set()
    for clause in clauses(selection):
        result = plain_value(clause.result)
        if result is False or result is None:
            continue
        parts = [*map(plain_value, clause.arguments), *([] if result is True else [result])]
        arguments = ",".join(map(term, parts))
        texts.add(functor(clause.relation) + (f"({arguments})" if parts else ""))
    return sorted(texts)


_WORDS = {True: "true", False: "false", None: "null"}


def _not_a_term(value: Any) -> ArgumentError:
    return ArgumentError(f"{type_in_words(value)} is no term: {short_repr(value)}")


# -- Prolog -----------------------------------------------------------------------------------


@form("prolog", select=with_arguments)
def _prolog(selection: Selection) -> list[str]:
    """The selected relations as Prolog clauses: a sorted list of texts, without the final dot."""
    return _clause_texts(selection, _atom, _term)


def _term(value: Any) -> str:
    match value:
        case bool() | None:
            return _WORDS[value]
        case int():
            return str(value)
        case float():
            return _float(value)
        case str():
            return _atom(value)
        case list():
            return f"[{', '.join(map(_term, value))}]"
    raise _not_a_term(value)


def _float(value: float) -> str:
    """Returns a float in the syntax of SWI-Prolog, with a decimal point; also inf and NaN."""
    if not math.isfinite(value):
        return "1.5NaN" if math.isnan(value) else f"{math.copysign(1, value)}Inf"
    number, exponent, power = repr(value).partition("e")
    return number + ("" if "." in number else ".0") + exponent + power


_CONSTANT = re.compile(r"[a-z][A-Za-z0-9_]*")
_ESCAPED = {"\\": "\\\\", "'": "\\'", "\n": "\\n", "\t": "\\t"}


def _atom(text: str) -> str:
    """Returns a text as an atom, quoted if necessary."""
    if _CONSTANT.fullmatch(text):
        return text
    return f"'{''.join(map(_in_quotes, text))}'"


def _in_quotes(letter: str) -> str:
    if letter in _ESCAPED:
        return _ESCAPED[letter]
    if letter.isprintable():
        return letter
    if "\ud800" <= letter <= "\udfff":
        raise ArgumentError(f"{short_repr(letter)} is no letter that Prolog knows")
    return f"\\x{ord(letter):x}\\"


# -- answer set programming -------------------------------------------------------------------

# clingo's integers have 32 bits.
_INTEGERS = range(-(2**31), 2**31)


@form(
    "asp",
    help="The selected relations as facts for clingo: a sorted list of texts, with the final "
    "dot. Fractions become strings, or integers if they are multiplied by scale.",
    select=with_arguments,
)
def _asp(selection: Selection, scale: float | None = None) -> list[str]:
    if scale is not None:
        validation.number_above_0(scale, "scale must be a number above 0")
    term = partial(_asp_term, scale=scale)
    return [f"{fact}." for fact in _clause_texts(selection, _predicate, term)]


def _asp_term(value: Any, scale: float | None) -> str:
    match value:
        case bool() | None:
            return _WORDS[value]
        case int():
            return str(value) if value in _INTEGERS else _string(str(value))
        case float():
            return _string(repr(value)) if scale is None else str(_scaled(value, scale))
        case str():
            return value if _CONSTANT.fullmatch(value) and value != "not" else _string(value)
        case list():
            terms = [_asp_term(part, scale) for part in value]
            return f"({terms[0]},)" if len(terms) == 1 else f"({','.join(terms)})"
    raise _not_a_term(value)


def _scaled(value: float, scale: float) -> int:
    scaled = value * scale
    if not math.isfinite(scaled) or round(scaled) not in _INTEGERS:
        raise ArgumentError(f"{value!r} times {scale!r} is no integer of 32 bits")
    return round(scaled)


def _predicate(name: str) -> str:
    if _CONSTANT.fullmatch(name) and name != "not":
        return name
    raise ArgumentError(
        f"{short_repr(name)} cannot be a predicate's name: a small letter first, then letters, "
        "digits "
        "and _; name it with to(…, 'name')"
    )


def _string(text: str) -> str:
    r"""Returns a text in quotes with the only escapes that clingo has: \\, \" and \n."""
    if "\0" in text or any("\ud800" <= letter <= "\udfff" for letter in text):
        raise ArgumentError(f"{short_repr(text)} has letters that clingo does not know")
    escaped = text.replace("\\", "\\\\").replace('"', '\\"').replace("\n", "\\n")
    return f'"{escaped}"'


LOGIC = (_prolog, _asp)
