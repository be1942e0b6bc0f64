"""Names of strangers write no control characters to a terminal: errors and warnings escape them."""

from __future__ import annotations

import warnings

import pytest

import ssduck
from ssduck.errors import ArgumentError, ProgramWarning, UnknownNameError, warn

HOSTILE = "cup\x1b[2J\x9b31m\u202e\r"
ESCAPED = "cup\\u001b[2J\\u009b31m\\u202e\\u000d"


@pytest.mark.parametrize(
    "error",
    [
        ArgumentError(f"no {HOSTILE}"),
        UnknownNameError("no", suggestions=[HOSTILE]),
        ArgumentError("no", text=f"{HOSTILE};", span=ssduck.errors.SourceSpan(0, 3)),
    ],
)
def test_errors(error: ssduck.SelectScriptError) -> None:
    text = str(error).replace("\n", "")
    assert text.isprintable()
    assert "[2J" in text
    assert "".join(error._render_traceback_()).replace("\n", "").isprintable()


def test_warnings() -> None:
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        warn(f"no {HOSTILE}", ProgramWarning)
    assert str(caught[0].message) == f"no {ESCAPED}"


def test_a_scene_and_a_record(tmp_path) -> None:
    for open_ in (ssduck.load, ssduck.open):
        with pytest.raises(ssduck.SelectScriptError) as caught:
            open_(f"{tmp_path}/{HOSTILE}")
        assert str(caught.value).isprintable()
        assert "[2J" in str(caught.value)
    (tmp_path / "a.toml").write_text(f'[[body]]\nname = "{ESCAPED}"\nbox = [1, 1]\n')
    with pytest.raises(ssduck.SelectScriptError) as caught:
        ssduck.load(tmp_path / "a.toml")
    assert str(caught.value).replace("\n", "").isprintable()


def test_lines_of_a_program_stay_lines() -> None:
    with ssduck.Interpreter() as ss, pytest.raises(UnknownNameError) as caught:
        ss.eval("\tnothing;")
    assert str(caught.value).endswith("    \tnothing;\n    \t^^^^^^^")
