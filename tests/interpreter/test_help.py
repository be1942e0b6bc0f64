"""Words of the language have help, as functions have."""

import pytest

import ssduck
from ssduck.errors import UnknownNameError


@pytest.mark.parametrize(
    ("word", "use"),
    [
        ("IMPLIES", "1 > 2 IMPLIES 2 > 3;"),
        ("XOR", "1 > 2 XOR 2 < 3;"),
        ("WHY", "WHY 1 < 2;"),
        ("EXPLAIN", "EXPLAIN 1 < 2;"),
    ],
)
def test_words_have_help(word, use):
    with ssduck.Interpreter() as ss:
        assert ss.help(word.lower()).startswith(f"{word}\n")
        assert word in ss.help(word).rpartition("\nUsage: ")[2]
        assert ss.eval(use)
        with pytest.raises(UnknownNameError, match=f"did you mean.*'{word}'"):
            ss.help(word[:-1])
