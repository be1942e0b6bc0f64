"""Reads model files as XML as simulators do: in UTF-8, and without namespaces."""

from __future__ import annotations

from pathlib import Path
from xml.etree import ElementTree as ET


def read_xml(file: Path) -> ET.Element:
    """Returns the root of a model file; the names of elements are without namespaces.

    MuJoCo and PyBullet know neither encodings nor namespaces: `<include xmlns="a"/>` is an include.

    Raises:
        ET.ParseError: the file is no XML in UTF-8.
        OSError: the file cannot be read.
        ValueError: there can be no file of that name.
    """
    parser = ET.XMLParser(encoding="utf-8")  # noqa: S314  # expat bounds the growth of entities
    root = ET.fromstring(file.read_bytes(), parser)  # noqa: S314
    for part in root.iter():
        part.tag = part.tag.rpartition("}")[2]
    return root
