"""A part of a model is known by its bytes, if its label alone is another, or by its rows."""

import zlib
from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from ssduck.lakes.groups import ModelPart
from ssduck.recording.paths import label_of
from ssduck.recording.stores.batched_parts import BatchedFile
from ssduck.recording.stores.checksums import write_parquet
from ssduck.recording.stores.parquet import _options as options
from ssduck.recording.stores.parquet_layout import FolderRun

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
    part = part_of(folder, 0)
    return rewritten(part, run=[RUN] * part.run.num_rows)


@pytest.mark.slow
@pytest.mark.parametrize("run", [0, 1, 1 << 32, RUN, RUN + 1])
def test_another_label_and_run(folder, first, run):
    part = part_of(folder, 1)
    other = rewritten(part, run=[run] * part.run.num_rows)
    assert first.is_copied_in(other.content, other.file.label) == (run == RUN)
    assert first.is_like(other)


@pytest.mark.slow
def test_no_other_byte_may_differ(folder, first):
    part = part_of(folder, 1)
    other = rewritten(part, run=[RUN] * part.run.num_rows)
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
