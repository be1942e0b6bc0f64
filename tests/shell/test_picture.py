"""The manual's picture of the shell shows what the shell answers."""

import re

import pytest

from tools import draw_shell


def texts(path):
    return re.findall(r"<text[^>]*>([^<]*)</text>", path.read_text(encoding="utf-8"))


@pytest.mark.slow
def test_the_manuals_picture_of_the_shell_is_up_to_date(tmp_path):
    drawn = texts(draw_shell.draw(tmp_path))
    assert len(drawn) > 20
    assert drawn == texts(draw_shell.IMAGES / "shell.svg")
