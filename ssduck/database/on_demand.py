"""Views and functions that DuckDB gets when a statement names them.

A world has some thirty views, and relations have as many functions: making all of them takes longer
than opening a small record and asking it a question.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Collection, Iterator
from collections.abc import Set as AbstractSet
from contextlib import contextmanager
from functools import lru_cache
from typing import Generic, TypeAlias, TypeVar

T = TypeVar("T")

# A schema, or None for names without one; and the name of a view or a function.
Name: TypeAlias = tuple[str | None, str]
# The number of statements whose names are known to be there.
_MAX_STATEMENTS = 4096


class OnDemand(Generic[T]):
    """Views and functions that are made before the first statement that names them.

    They are made by functions of the connection, which do not keep it alive.
    """

    def __init__(self) -> None:
        self._makers: dict[Name, Callable[[T], None]] = {}
        # Statements that name nothing that is still to be made.
        self._complete: set[str] = set()
        # What is not made now; see `without`.
        self._left_out: frozenset[Name] = frozenset()

    def offer(self, name: Name, make: Callable[[T], None]) -> None:
        """Has a view or a function made when a statement names it; replaces an earlier offer."""
        self._makers[name] = make
        self._complete.clear()

    def withdraw(self, name: Name) -> None:
        """Takes an offer back."""
        self._makers.pop(name, None)

    def withdraw_schema(self, schema: str) -> None:
        """Takes the offers of the views of a schema back."""
        for name in [name for name in self._makers if name[0] == schema]:
            del self._makers[name]

    def clear(self) -> None:
        """Takes all offers back, as the connection is closed."""
        self._makers.clear()

    def make(self, name: Name, connection: T) -> None:
        """Makes a view or a function if that has not been done."""
        maker = self._makers.get(name)
        if maker is not None:
            maker(connection)
            self._makers.pop(name, None)

    def make_all(self, connection: T) -> None:
        """Makes everything, for a statement that may read anything."""
        while self._makers:
            self.make(next(iter(self._makers)), connection)

    def make_named(self, words: AbstractSet[str], connection: T) -> None:
        """Makes what words in small letters name; names in a user's query may omit the schema."""
        for name in [name for name in self._makers if name[1].casefold() in words]:
            self.make(name, connection)

    def make_schema(self, schema: str, connection: T) -> None:
        """Makes the views of a schema."""
        for name in [name for name in self._makers if name[0] == schema]:
            self.make(name, connection)

    def is_offered(self, name: Name) -> bool:
        """Checks whether a view or a function is still to be made."""
        return name in self._makers

    @property
    def leaves_out(self) -> bool:
        """Whether a statement runs that has names left out; one that runs within it may not."""
        return bool(self._left_out)

    @contextmanager
    def without(self, names: Collection[Name]) -> Iterator[None]:
        """Has `provide` make none of some names in a context: they are there, in part."""
        before, self._left_out = self._left_out, frozenset(names)
        try:
            yield
        finally:
            self._left_out = before

    def provide(self, sql: str, connection: T) -> None:
        """Makes what one of ssduck's own statements may name."""
        if not self._makers or sql in self._complete:
            return
        text = sql.casefold()  # SQL ignores case
        for schema, name in list(self._makers):
            if (schema, name) in self._left_out:
                continue
            # A name may be quoted.
            is_named = schema is None or schema.casefold().replace('"', '""') in text
            if is_named and _word(name).search(text):
                self.make((schema, name), connection)
        if self._left_out:
            return
        if len(self._complete) >= _MAX_STATEMENTS:
            self._complete.clear()
        self._complete.add(sql)


@lru_cache(maxsize=1024)
def _word(name: str) -> re.Pattern[str]:
    return re.compile(rf"(?<!\w){re.escape(name.casefold())}(?!\w)")
