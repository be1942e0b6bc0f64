"""The kitchen as clauses, asked in Prolog, or in answer sets where there is no SWI-Prolog.

As in the tutorial's section 10.3. SWI-Prolog (`swipl`) or clingo (from PyPI) answers its three
questions; the answers must be those of the same questions in SelectScript.
"""

from __future__ import annotations

import shutil
import subprocess
import warnings
from collections.abc import Callable, Sequence
from importlib.util import find_spec
from pathlib import Path
from typing import TypeAlias

from ssduck.demos.results import Say, keep
from ssduck.errors import ProgramWarning, SelectScriptError
from ssduck.formatting import error_text
from ssduck.interpreter.interpreter import Interpreter
from ssduck.interpreter.opening import load

Question: TypeAlias = tuple[str, str, str, str]
Engine: TypeAlias = "Callable[[Interpreter, Path, Question], Sequence[str]]"

CLAUSES = """\
SELECT above(a.this, b.this), isEnabled(a.this), volume(a.this), position(a.this),
    isRobot(a.this), isKinbody(a.this)
FROM a=kitchen, b=kitchen
WHERE NOT (isSensor(a.this) OR isSensor(b.this))
AS {};"""

# A goal in Prolog, its variable, the same as a rule for clingo, and in SelectScript.
QUESTIONS: tuple[Question, ...] = (
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
# clingo has integers only: in millionths of a metre or of a cubic metre.
SCALE = 1_000_000


def run(folder: Path, say: Say, *, seed: int) -> bool:  # noqa: ARG001
    """Writes the clauses and compares the answers; without an engine, only SelectScript answers."""
    with load("kitchen") as ss, warnings.catch_warnings():
        warnings.simplefilter("ignore", ProgramWarning)  # of volume, which is as published
        say(CLAUSES.format("prolog"))
        clauses: list[str] = ss.eval(CLAUSES.format("prolog"))
        text = "".join(f"{clause}.\n" for clause in clauses)
        target = keep(folder / "kitchen.pl", lambda path: path.write_text(text, encoding="utf-8"))
        ss.add_variable("table", ss.call_variable("kitchen")["table"])
        say("\n".join([*clauses[:9], "…", f"{len(clauses)} clauses, all in {target}"]))
        engine = _engine(say)
        succeeded = True
        for question in QUESTIONS:
            expected = sorted(ss.eval(question[3]))
            answers = expected if engine is None else sorted(engine(ss, target, question))
            say(f"?- {question[0]}.\n   {question[1]} = {', '.join(answers)}")
            if engine is not None:
                say(f"SelectScript says {'the same' if answers == expected else expected}")
            succeeded &= answers == expected and bool(answers)
    return succeeded


def _engine(say: Say) -> Engine | None:
    """Returns the installed engine; None, with a hint on what to install, if there is none."""
    if shutil.which("swipl"):
        say("The questions are put to SWI-Prolog")
        return _prolog
    if find_spec("clingo"):
        say("The questions are put to clingo")
        return _clingo
    say(
        "Neither SWI-Prolog (the program swipl, https://www.swi-prolog.org) nor clingo "
        "(pip install clingo) is here to be asked: these are SelectScript's own answers"
    )
    return None


def _prolog(_: Interpreter, target: Path, question: Question) -> Sequence[str]:
    """Returns the answers of SWI-Prolog, which reads the file."""
    query, variable, *_others = question
    goal = f"forall(({query}), (write({variable}), nl)), halt"
    command = ["swipl", "-q", "-g", goal, "-t", "halt(1)", str(target)]
    try:
        process = subprocess.run(  # noqa: S603
            command, capture_output=True, text=True, timeout=60, check=True
        )
    except (OSError, subprocess.SubprocessError) as error:
        reason = getattr(error, "stderr", None) or error
        raise SelectScriptError(f"swipl failed: {error_text(Exception(reason))}") from error
    return process.stdout.split()


def _clingo(ss: Interpreter, _: Path, question: Question) -> Sequence[str]:
    import clingo

    facts = ss.eval(CLAUSES.format(f"asp(scale={SCALE})"))
    control = clingo.Control(["--warn=none"])
    control.add("base", [], "\n".join([*facts, question[2], "#show found/1."]))
    control.ground([("base", [])])
    with control.solve(yield_=True) as models:
        return [str(each.arguments[0]) for model in models for each in model.symbols(shown=True)]
