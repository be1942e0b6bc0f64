"""Why a condition holds or not: its parts, with their values, margins and the ticks that decide."""

from __future__ import annotations

import html
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

from ssduck.errors import printable

# The colours of conditions by their values, for people: green, red, grey.
COLOURS = {True: "#1a7f37", False: "#cf222e", None: "#6e7781"}


@dataclass(frozen=True)
class Move:
    """A translation of an entity after which a condition has the other value.

    It is the shortest one along an axis, or along the line of the nearest or the deepest points.
    """

    entity: str  # the name of the entity
    translation: tuple[float, float, float]  # in the world frame, m

    def __str__(self) -> str:
        way = ", ".join(f"{round(part, 9) + 0.0:.4g}" for part in self.translation)
        return f"moved by [{way}] m, {self.entity} would change that"


@dataclass(frozen=True, repr=False)
class Why:
    """A condition, with what it is and why: a tree of its parts.

    A terminal and a notebook show the tree.
    """

    text: str  # the text of the condition
    value: Any  # True, False, or None where it is unknown or not decided
    margin: float | None = None  # its margin, in the unit of its comparison; None without one
    time: float | None = None  # the simulated time of the tick that it is of, s
    detail: str = ""  # the values that it compares
    # Two points in the world frame, m: those between which a distance is least, or the position of
    # an entity and where its coordinate would be the number that it is compared with.
    points: tuple[tuple[float, ...], ...] = ()
    entities: tuple[str, ...] = ()  # the full names of the entities and links that it is of
    move: Move | None = None  # what would change it; None if that is not known
    parts: tuple[Why, ...] = ()
    complete: bool = True  # whether later ticks, behind the end of a record, could not change it

    @property
    def mark(self) -> str:
        """A tick, a cross, or a question mark."""
        return "?" if self.value is None else "✓" if self.value else "✗"

    def rows(self) -> list[dict[str, Any]]:
        """Returns the parts as rows, each before its own parts: for a data frame, or for JSON."""
        return [
            {
                "depth": depth,
                "text": part.text,
                "value": part.value,
                "margin": part.margin,
                "time": part.time,
                "detail": part.detail,
                "points": [list(point) for point in part.points],
                "entities": list(part.entities),
                "move": None if part.move is None else str(part.move),
                "complete": part.complete,
            }
            for depth, part in self.walk()
        ]

    def walk(self, depth: int = 0) -> Iterator[tuple[int, Why]]:
        """Yields the parts, each before its own parts, with their depths."""
        yield depth, self
        for part in self.parts:
            yield from part.walk(depth + 1)

    @property
    def decided_at(self) -> float | None:
        """The time of the tick that decides, s; None if it is the one at which it is asked."""
        if not self.parts:
            return None
        same = (part for part in self.parts if part.value == self.value)
        part = next(same, self.parts[0])
        return part.decided_at if part.time is None else part.time

    def told(self, *, margins: bool = True) -> Iterator[tuple[int, Why, str]]:
        """Yields the parts, each before its own parts, with their depths and what is told of each.

        The time of a tick is told where it changes.

        Args:
            margins: whether the margins are told.
        """
        before: float | None = None
        for depth, part in self.walk():
            notes = [part.detail] if part.detail else []
            if margins and part.margin is not None:
                notes.append(f"margin {part.margin:.4g}")
            if part.time is not None and part.time != before:
                notes.append(f"at {part.time:g} s")
            if part.move is not None:
                notes.append(str(part.move))
            before = part.time
            yield depth, part, printable("; ".join(notes))

    def __str__(self) -> str:
        return "\n".join(
            f"{'  ' * depth}{part.mark} {printable(part.text)}" + (f"  ({told})" if told else "")
            for depth, part, told in self.told()
        )

    __repr__ = __str__

    def _repr_html_(self) -> str:
        return "".join(
            f'<div style="padding-left: {2 * depth}em">'
            f'<b style="color: {COLOURS[part.value]}">{part.mark}</b> '
            f"<code>{html.escape(printable(part.text))}</code> {html.escape(told)}</div>"
            for depth, part, told in self.told()
        )
