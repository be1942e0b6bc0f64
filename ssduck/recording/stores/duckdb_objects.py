"""The objects of an S3 store as DuckDB reads them, by fsspec; needs the extra `s3`."""

from __future__ import annotations

import re
from typing import Any

from fsspec.implementations.arrow import ArrowFSWrapper

_MAGIC = re.compile(r"[*?[]")
# A letter of a pattern that stands for itself.
_ESCAPED = re.compile(r"\[([*?[])\]")


class DuckdbObjects(ArrowFSWrapper):  # type: ignore[misc]  # fsspec has no types
    """The objects of a store, by their addresses."""

    protocol = "s3"

    @classmethod
    def _strip_protocol(cls, path: str) -> str:
        """Returns the key of an address, which is no URL: `?` and `#` are letters of it."""
        return path.removeprefix("s3://")

    def glob(self, path: str, maxdepth: int | None = None, **options: Any) -> Any:
        """Returns the keys that a pattern matches; without open patterns, it lists no others."""
        if _MAGIC.search(_ESCAPED.sub("", path)):
            return super().glob(path, maxdepth, **options)
        exact = self._strip_protocol(_ESCAPED.sub(r"\1", path))
        return [exact] if self.exists(exact) else []
