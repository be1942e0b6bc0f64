"""What the user says of the bodies of a client: their names, kinds and shapes."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

from ssduck.errors import ProgramWarning, warn
from ssduck.formatting import joined_names
from ssduck.simulators.interface import Body, Kind
from ssduck.simulators.pybullet.bodies import UserShapes


class GivenBodies:
    """What the user says of present bodies, by PyBullet body number.

    PyBullet reuses the numbers, so it is not said of later bodies, with one exception: an episode
    begins with bodies that were built again. One that is like the first of its number has its name
    and its kind.

    Args:
        names: names of bodies, instead of those of their models.
        kinds: kinds of bodies, instead of those that follow from their joints.
        shapes: the user's own shapes.

    Attributes:
        names, kinds, shapes: those of the bodies that are described next.
    """

    def __init__(
        self,
        names: Mapping[int, str] | None,
        kinds: Mapping[int, Kind] | None,
        shapes: Mapping[int, UserShapes] | None,
    ) -> None:
        self.names, self.kinds, self.shapes = dict(names or {}), dict(kinds or {}), shapes or {}
        self._all = dict(self.names), dict(self.kinds)
        # The forms of the bodies that were described first.
        self._forms: dict[int, Any] | None = None

    def begin_episode(self) -> None:
        """Says the names and kinds of the bodies that are described next."""
        self.names, self.kinds = dict(self._all[0]), dict(self._all[1])

    def changed(self, bodies: Iterable[Body]) -> list[int]:
        """Returns the numbers of the described bodies that are not like the first; warns of these.

        Nothing is said of them any more.
        """
        forms = {b.handle: _form(b) for b in bodies if b.handle in {**self.names, **self.kinds}}
        if self._forms is None:
            self._forms = forms
        changed = [handle for handle, form in forms.items() if form != self._forms.get(handle)]
        names = [self.names.pop(handle) for handle in changed if handle in self.names]
        for handle in changed:
            self.kinds.pop(handle, None)
        if names:
            warn(
                f"{joined_names(names)}: begin_episode found other bodies, or other shapes, under "
                "the numbers of these, and names them as in their models: attach the client again, "
                "with names=, after each reset that builds another scene",
                ProgramWarning,
            )
        return changed

    def end(self) -> None:
        """Says nothing of the bodies that are described next."""
        self.names, self.kinds, self.shapes = {}, {}, {}


def _form(body: Body) -> Any:
    """Returns what two bodies of the same model have in common."""
    shapes = [
        (shape.frame, shape.geometry.key, shape.position.tolist(), shape.orientation.tolist())
        for shape in body.shapes
    ]
    links = [(link.name, link.parent) for link in body.links]
    return body.movable, links, [(joint.name, joint.type) for joint in body.joints], shapes
