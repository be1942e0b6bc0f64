"""Reads model files as XML, for names and settings that PyBullet does not report."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from xml.etree import ElementTree as ET

from ssduck.errors import SceneError
from ssduck.simulators.scene_bodies import BodySpec


@dataclass(frozen=True, eq=False)
class ModelFile:
    """A model file as XML.

    Attributes:
        format: one of `MODEL_FILES`.
        root: the root element; an empty element for a file that is not XML.
    """

    format: str
    root: ET.Element

    @classmethod
    def read(cls, spec: BodySpec) -> ModelFile:
        """Reads the file of a scene entry."""
        assert isinstance(spec.model, Path)
        try:
            root = ET.parse(spec.model).getroot()  # noqa: S314  # PyBullet reads it, too
        except (ET.ParseError, OSError, ValueError):
            root = ET.Element("none")  # PyBullet may read it all the same
        return cls(spec.source, root)

    def check(self) -> None:
        """Checks that PyBullet can read the file; some files crash it.

        Raises:
            SceneError: a model of an SDF file has several links without a parent.
        """
        for model in self._models():
            links = {link.get("name") for link in model.findall("link")}
            children = {(child.text or "").strip() for child in model.iterfind("joint/child")}
            roots = sorted(str(name) for name in links - children)
            if len(roots) > 1:
                raise SceneError(
                    f"the model {model.get('name')!r} has {len(roots)} links without a parent "
                    f"({', '.join(roots)}); PyBullet needs a joint that connects them"
                )

    def static_models(self) -> set[int]:
        """Returns the indices of the static models of an SDF file.

        PyBullet reads `1`, but not `true`.
        """
        return {
            number
            for number, model in enumerate(self._models())
            if (model.findtext("static") or "").strip().lower() in ("1", "true")
        }

    def names(self) -> set[str | None]:
        """Returns the names that an MJCF file gives to bodies and shapes."""
        return {part.get("name") for tag in ("body", "geom") for part in self.root.iter(tag)}

    def _models(self) -> list[ET.Element]:
        """Returns the models of an SDF file that PyBullet loads, in its order."""
        if self.format != "sdf":
            return []
        world = self.root.find("world")
        return (self.root if world is None else world).findall("model")
