"""The kitchen as clauses, asked in Prolog, or in answer sets where there is no SWI-Prolog.

As the tutorial's section 10.3: one query becomes clauses, `above(table,cup_58a2)`, and the three
questions that are printed there are put to SWI-Prolog (`swipl`), or to clingo (of PyPI). Their
answers have to be those of the same questions in SelectScript.
"""

from __future__ import annotations

import json
import shutil
import subprocess
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from ssduck.interpreter import Interpreter

CLAUSES = """\
SELECT above(a.this, b.this), isEnabled(a.this), volume(a.this), position(a.this),
    isRobot(a.this), isKinbody(a.this)
FROM a=kitchen, b=kitchen
WHERE NOT (isSensor(a.this) OR isSensor(b.this))
AS {};"""

# A question in Prolog, what it finds, the same as a rule of an answer set, and in SelectScript.
QUESTIONS = (
    (
        "above(table, X)",
        "X",
        "found(X) :- above(table, X).",
        "SELECT id FROM kitchen WHERE above(table, this) AND NOT isSensor(this) AS list;",
    ),
    (
        "volume(Obj, V), V > 1.0",
        "Obj",
        "found(X) :- volume(X, V), V > 1000000.",
        "SELECT id FROM kitchen WHERE NOT isSensor(this) AND volume(this) > 1.0 AS list;",
    ),
    (
        "position(X, _)",
        "X",
        "found(X) :- position(X, _).",
        "SELECT id FROM kitchen WHERE NOT isSensor(this) AS list;",
    ),
)
# For clingo, which has whole numbers only: of a millionth of a metre, or of a cubic metre.
SCALE = 1_000_000


def run(folder: Path, say: Callable[[str], None], *, seed: int) -> bool:  # noqa: ARG001
    """Write the clauses, ask, and compare."""
    from ssduck.opening import load

    with load("kitchen") as ss:
        engine, ask = ("SWI-Prolog", _prolog) if shutil.which("swipl") else ("clingo", _clingo)
        if engine == "clingo" and not _has_clingo():
            say("Neither SWI-Prolog (swipl) nor clingo (pip install clingo) is here to be asked")
            return False
        say(CLAUSES.format("prolog"))
        clauses: list[str] = ss.eval(CLAUSES.format("prolog"))
        target = folder / "kitchen.pl"
        target.write_text("".join(f"{clause}.\n" for clause in clauses))
        ss.add_variable("table", ss.call_variable("kitchen")["table"])
        say("\n".join([*clauses[:9], "…", f"{len(clauses)} clauses, all in {target}"]))
        say(f"The questions are put to {engine}")
        found = True
        for number, question in enumerate(QUESTIONS):
            answers = sorted(ask(ss, target, number))
            expected = sorted(ss.eval(question[3]))
            say(f"?- {question[0]}.\n   {question[1]} = {', '.join(answers)}")
            say(f"SelectScript says {'the same' if answers == expected else expected}")
            found &= answers == expected and bool(answers)
    return found


def _prolog(_: Interpreter, target: Path, number: int) -> Sequence[str]:
    """The answers of SWI-Prolog, which reads the file."""
    asked, variable, *_others = QUESTIONS[number]
    goal = (
        f"use_module(library(http/json)), findall({variable}, ({asked}), L), "
        "json_write(current_output, L), halt"
    )
    command = ["swipl", "-q", "-g", goal, "-t", "halt(1)", str(target)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=60, check=True)  # noqa: S603
    answers: list[str] = json.loads(done.stdout)
    return answers


def _has_clingo() -> bool:
    try:
        import clingo  # noqa: F401
    except ImportError:
        return False
    return True


def _clingo(ss: Interpreter, _: Path, number: int) -> Sequence[str]:
    """The answers of clingo."""
    import clingo

    facts = ss.eval(CLAUSES.format(f"asp(scale={SCALE})"))
    control = clingo.Control(["--warn=none"])
    control.add("base", [], "\n".join([*facts, QUESTIONS[number][2], "#show found/1."]))
    control.ground([("base", [])])
    found: list[str] = []
    control.solve(
        on_model=lambda model: found.extend(
            str(symbol.arguments[0]) for symbol in model.symbols(shown=True)
        )
    )
    return found
