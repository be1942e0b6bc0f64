"""Worlds of this process in a sandbox: copies there, which get what is new before each question."""

from __future__ import annotations

from collections.abc import Callable, Collection
from dataclasses import dataclass
from typing import Any

from ssduck.errors import UnsupportedError
from ssduck.interpreter.interpreter import Interpreter
from ssduck.interpreter.mirrors import WorldFeed, WorldNews
from ssduck.sandbox.references import SandboxedWorld
from ssduck.world.batches.batch_world import BatchWorld
from ssduck.world.world import World


@dataclass(frozen=True)
class _Live:
    """A world of an interpreter of this process, and whether its copy goes to recorded ticks."""

    owner: Interpreter
    world: World
    is_past: bool


class LiveWorlds:
    """The worlds of this process that programs in a sandbox ask.

    Their ticks are recorded here, from when they are added.
    """

    def __init__(self) -> None:
        self._worlds: dict[str, _Live] = {}
        self._feeds: dict[str, WorldFeed] = {}
        self._recording: Interpreter | None = None

    def add(
        self,
        name: str,
        world: World,
        owner: Interpreter | None = None,
        *,
        is_past: bool = False,
    ) -> None:
        """Adds a world, which an interpreter of this process records.

        Args:
            name: the name of its copy.
            world: the world.
            owner: the interpreter; None for one of its own, with the default recording.
            is_past: whether the copy goes to recorded ticks; else it is of the last tick.
        """
        if isinstance(world, BatchWorld):
            raise UnsupportedError(f"{name!r} is a batch of worlds, which a sandbox cannot have")
        if owner is None:
            owner = self._recording = self._recording or Interpreter()
            owner.add_variable(name, world)
        live = _Live(owner, world, is_past)
        if self._worlds.get(name) != live:
            self._worlds[name] = live
            self._feeds.pop(name, None)

    def __contains__(self, name: object) -> bool:
        """Checks whether a world has a name."""
        return name in self._worlds

    def __getitem__(self, name: str) -> World:
        return self._worlds[name].world

    def remove(self, name: str) -> None:
        """Removes a world, if there is one of that name."""
        self._worlds.pop(name, None)
        self._feeds.pop(name, None)

    def name_of(self, world: Any) -> str:
        """Returns the name of a world of the sandbox, or of the copy of one of this process."""
        if isinstance(world, SandboxedWorld):
            return world.name
        for name, live in self._worlds.items():
            if live.world is world:
                return name
        raise UnsupportedError(
            f"{world!r} is a world of this process: add it as a variable of the sandbox first"
        )

    def begin_anew(self) -> None:
        """Sends everything again: the process of the sandbox is another one."""
        self._feeds.clear()

    def update(self, ask: Callable[..., Any]) -> None:
        """Sends what is new to the sandbox.

        Args:
            ask: asks the sandbox.
        """
        for name, live in self._worlds.items():
            feed = self._feeds.get(name)
            if feed is None or not feed.is_up_to_date:
                feed = WorldFeed(live.owner, live.world, name, is_past=live.is_past)
                ask("worker.copy_world", vars(feed.description))
            self._feeds.pop(name, None)  # until the copy has what is new
            if (news := feed.news()) is not None:
                ask("worker.update_world", name, vars(news))
            self._feeds[name] = feed

    def news(self, name: str, tables: Collection[str]) -> dict[str, Any]:
        """Returns the last tick of a world, with tables that are read on request only."""
        news = self._feeds[name].news(tables)
        assert isinstance(news, WorldNews)
        return vars(news)

    def close(self) -> None:
        """Ends the recording; the worlds go on."""
        if self._recording is not None:
            self._recording.close()
