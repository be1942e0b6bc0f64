"""A part of a model is known by its bytes, if its label and its run alone are others."""

import zlib
from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from ssduck.lakes.model_parts import ModelPart
from ssduck.recording.stores.batched_parts import BatchedFile
from ssduck.recording.stores.checksums import write_parquet
from ssduck.recording.stores.parquet import _options as options
from ssduck.recording.stores.parquet_layout import FolderRun
from ssduck.recording.stores.part_names import label_of

TABLE = "models/entities"
RUN = 1 << 52


def part_of(folder, number):
    """Returns the entities of an episode."""
    path = folder / f"{TABLE}/world=sim/episode={number}/part-000000.parquet"
    content = path.read_bytes()
    label = label_of(FolderRun(folder, "sim", number).key, TABLE, 0)
    return ModelPart(BatchedFile(str(path), zlib.crc32(content), label, TABLE), content)


def rewritten(part, **columns):
    """Writes other values of some columns, as the store does, and returns the part."""
    path = Path(part.file.path)
    rows = pq.read_table(path, partitioning=None)
    for name, values in columns.items():
        place = rows.column_names.index(name)
        rows = rows.set_column(place, rows.schema.field(name), pa.array(values))
    write_parquet(rows, path, **options(rows))
    return ModelPart(part.file, path.read_bytes())


@pytest.fixture
def first(folder):
    """The part with a run whose checksum has five bytes, as most have."""
    part = part_of(folder, 0)
    count = part.run.num_rows
    parts = (rewritten(part, run=[RUN + n] * count) for n in range(40))
    return max(parts, key=lambda one: len(one.content))


@pytest.mark.slow
def test_another_label_and_run(folder, first):
    part, sizes = part_of(folder, 1), set()
    for run in (0, 1, 1 << 32, *range(RUN + 40, RUN + 100)):
        other = rewritten(part, run=[run] * part.run.num_rows)
        is_long = len(other.content) == len(first.content)
        assert first.is_copied_in(other.content, other.file.label) == is_long
        assert first.is_like(other)
        sizes.add(is_long)
    assert True in sizes


@pytest.mark.slow
def test_no_other_byte_may_differ(folder, first):
    part = part_of(folder, 1)
    others = (rewritten(part, run=[n] * part.run.num_rows) for n in range(RUN, RUN + 40))
    other = max(others, key=lambda one: len(one.content))
    assert first.is_copied_in(other.content, other.file.label)
    content = bytearray(other.content)
    for place in range(len(content)):
        content[place] ^= 1
        assert not first.is_copied_in(bytes(content), other.file.label), place
        content[place] ^= 1


def test_other_rows_with_right_checksums(folder, first):
    part = part_of(folder, 1)
    rows = part._part.rows()
    names, masses = rows["name"].to_pylist(), rows["mass"].to_pylist()
    changes = (
        {"name": [name[::-1] for name in names]},
        {"mass": [mass and mass + 1 for mass in masses]},
        {"run": [RUN, *[RUN + 1] * (len(names) - 1)]},
    )
    for change in changes:
        other = rewritten(
            part, **{"run": [RUN] * len(names), "name": names, "mass": masses} | change
        )
        assert not first.is_copied_in(other.content, other.file.label)


@pytest.mark.parametrize("run", [0, 1 << 32])
def test_a_run_that_may_be_other_bytes_is_decoded(folder, run):
    part = part_of(folder, 0)
    first = rewritten(part, run=[run] * part.run.num_rows)
    part = part_of(folder, 1)
    other = rewritten(part, run=[run + 1] * part.run.num_rows)
    assert not first.is_copied_in(other.content, other.file.label)
    assert first.is_like(other)


def test_a_run_whose_bytes_are_in_the_footer_is_decoded(folder):
    """They may stand for where a column begins, and other bytes for another place."""
    part = part_of(folder, 0)
    footer = part.content[-int.from_bytes(part.content[-8:-4], "little") - 8 : -8]
    columns = footer.index(b"mass")
    number = next(
        footer[place : place + 8]
        for place in range(columns, len(footer))
        if RUN <= int.from_bytes(footer[place : place + 8], "little") < 1 << 63
    )
    run = [int.from_bytes(number, "little")] * part.run.num_rows
    first, other = rewritten(part, run=run), rewritten(part_of(folder, 1), run=run)
    assert number in first.content[-len(footer) :]
    assert first._run is None
    assert first.is_like(other)
