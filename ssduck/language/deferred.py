"""Lists that are evaluated by the query that uses them."""

from __future__ import annotations

from ssduck.language.tree import Node


class LazyList:
    """A list that mentions elements of sources that do not exist yet.

    It is resolved in the query that uses it.

    Args:
        node: the list, or a list or text that contains it.
        text: the program that it is from.
    """

    IN_WORDS = "a list for the query that uses it"

    def __init__(self, node: Node, text: str) -> None:
        self.node = node
        self.text = text

    def __repr__(self) -> str:
        return f"<list for the query that uses it: {self.source}>"

    @property
    def source(self) -> str:
        """The text of the list as it was written."""
        return self.text[self.node.span.start : self.node.span.end]
