"""Records that several files open, and do not change."""

import pytest


@pytest.fixture(scope="session")
def small_records(tmp_path_factory, archive):
    """`folder`, `unfinished` and `file.duckdb` of `tests.support.forged`, in a folder."""
    from tests.support.forged import make_records  # where it is used: it needs PyBullet

    place = tmp_path_factory.mktemp("small")
    archive.copy(make_records, place)
    return place
