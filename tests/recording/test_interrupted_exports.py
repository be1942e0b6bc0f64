"""Ctrl-C in a call of `export`, `upgrade` or `write_record`: nothing is left, or the whole."""

from __future__ import annotations

import inspect
import math
import signal
from collections.abc import Callable, Iterator
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest

import ssduck
from ssduck.interchange import record_writer
from ssduck.interpreter import recording, upgrading
from ssduck.recording import export as exporting
from ssduck.recording import folder_episodes
from ssduck.recording.stores import parquet
from tests.support.presser import Presser

POSES = {"cup": [[0, 0, 1], [0, 0, 2]]}
# The modules at each line of which Ctrl-C is pressed.
MODULES: tuple[ModuleType, ...] = (
    exporting,
    folder_episodes,
    parquet,
    record_writer,
    recording,
    upgrading,
)
PLACES = tuple(inspect.getfile(module) for module in MODULES)


def write(place: Path, **options: Any) -> None:
    ssduck.write_record(place, ["cup"], POSES, [0.0, 0.1], **options)


@pytest.fixture
def record(tmp_path: Path) -> Path:
    write(tmp_path / "record", world="lab")
    return tmp_path / "record"


@pytest.fixture(autouse=True)
def handler() -> Iterator[None]:
    kept = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, kept)


def files_in(place: Path) -> dict[Path, bytes]:
    return {file: file.read_bytes() for file in place.rglob("*") if file.is_file()}


def _export(record: Path, folder: Path) -> None:
    with ssduck.open(record) as ss:
        ss.export(folder, pairs=0.1)


def _upgrade(record: Path, folder: Path) -> None:
    ssduck.upgrade(record, folder)


def _write(_: Path, folder: Path) -> None:
    write(folder, world="lab")


Call = Callable[[Path, Path], None]


def pressed(call: Call, record: Path, folder: Path, line: float) -> int:
    """Presses Ctrl-C at a line of a call; returns the number of lines until it came."""
    with Presser(line, places=PLACES) as presser:
        try:
            call(record, folder)
        except KeyboardInterrupt:
            pass
        else:
            assert presser.count < line
    return presser.count


@pytest.mark.parametrize("call", [_export, _upgrade, _write])
@pytest.mark.parametrize("has_others", [False, True], ids=["a new folder", "a record"])
def test_nothing_is_left_or_the_whole(
    record: Path, tmp_path: Path, call: Call, has_others: bool
) -> None:
    if call is _upgrade and has_others:
        pytest.skip("an upgrade makes a new folder")
    count = pressed(call, record, tmp_path / "whole", math.inf)
    whole = ssduck.episodes(tmp_path / "whole")
    assert count > 50
    for line in range(1, count + 1):
        folder = tmp_path / "a" / str(line)
        if has_others:
            write(folder, world="other")
        before = files_in(folder)
        pressed(call, record, folder, line)
        if files_in(folder) == before:
            assert has_others or not folder.exists()
        else:
            made = [one for one in ssduck.episodes(folder) if one.world == "lab"]
            assert [(e.ticks, e.complete) for e in made] == [(e.ticks, e.complete) for e in whole]
            assert ssduck.check(folder) == []
            assert not [place for place in folder.rglob("*") if place.name.startswith(".")]
        assert not list(folder.parent.glob(".*"))
