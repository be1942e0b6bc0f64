"""A recorded world runs for long and takes no more memory: a short form of `python -m tools.soak`."""

import pytest

from tools import soak


@pytest.mark.long
@pytest.mark.parametrize("in_file", [False, True], ids=["memory", "file"])
def test_memory_does_not_grow(tmp_path, in_file, capsys):
    database = str(tmp_path / "soak.duckdb") if in_file else ":memory:"
    megabytes = soak.memory_of_run(8_000, 0, database)
    assert capsys.readouterr().out.count("MB") == 10
    assert megabytes[-1] < soak.MAX_GROWTH * megabytes[0]
