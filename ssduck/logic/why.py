"""Why a condition holds or not: its parts, with their values, margins and the ticks that decide."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True)
class Move:
    """A translation of an entity after which a condition has the other value.

    It is the smallest one where the shapes between which the distance is least are convex there.
    """

    entity: str  # the name of the entity
    translation: tuple[float, float, float]  # in the world frame, m

    def __str__(self) -> str:
        way = ", ".join(f"{round(part, 9) + 0.0:.4g}" for part in self.translation)
        return f"moved by [{way}] m, {self.entity} would change that"


@dataclass(frozen=True)
class Why:
    """A condition, with what it is and why: a tree of its parts."""

    text: str  # the text of the condition
    value: Any  # True, False, or None where it is unknown or not decided
    margin: float | None = None  # its margin, in the unit of its comparison; None without one
    time: float | None = None  # the simulated time of the tick that it is of, s
    detail: str = ""  # the values that it compares
    # The points between which a distance is least, in the world frame, m.
    points: tuple[tuple[float, ...], ...] = ()
    move: Move | None = None  # what would change it; None if that is not known
    parts: tuple[Why, ...] = ()

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
                "move": None if part.move is None else str(part.move),
            }
            for depth, part in self.walk()
        ]

    def walk(self, depth: int = 0) -> Iterator[tuple[int, Why]]:
        """Yields the parts, each before its own parts, with their depths."""
        yield depth, self
        for part in self.parts:
            yield from part.walk(depth + 1)

    def __str__(self) -> str:
        lines = []
        before: float | None = None
        for depth, part in self.walk():
            notes = [part.detail] if part.detail else []
            if part.margin is not None:
                notes.append(f"margin {part.margin:.4g}")
            if part.time is not None and part.time != before:
                notes.append(f"at {part.time:g} s")
            if part.move is not None:
                notes.append(str(part.move))
            before = part.time
            told = f"  ({'; '.join(notes)})" if notes else ""
            lines.append(f"{'  ' * depth}{part.mark} {part.text}{told}")
        return "\n".join(lines)
