"""The poses of named frames of an episode that another tool wrote."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import pyarrow as pa


@dataclass(frozen=True)
class ImportedPoses:
    """The poses of an episode.

    Attributes:
        names: the names of the frames, those of entities that are known before those of links.
        tables: tables of poses, as `ssduck.write_record` takes them, one after the other.
        about: what the source says of the episode: `world`, `tags`, `kinds` and `task`.
        unread: what is in the source and not in the tables.
    """

    names: Sequence[str]
    tables: Iterable[pa.Table]
    about: Mapping[str, Any]
    unread: Sequence[str]
