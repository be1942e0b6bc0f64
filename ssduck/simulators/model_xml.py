"""Reads model files as XML as simulators do: in UTF-8, and without namespaces."""

from __future__ import annotations

from pathlib import Path
from xml.etree import ElementTree as ET


def read_xml(file: Path, *, with_comments: bool = False) -> ET.Element:
    """Returns the root of a model file; the names of elements are without namespaces.

    MuJoCo and PyBullet know neither encodings nor namespaces: `<include xmlns="a"/>` is an include.

    Args:
        file: the model file.
        with_comments: whether comments and processing instructions inside the root are children,
            too; their tags are functions.

    Raises:
        ET.ParseError: the file is no XML in UTF-8.
        OSError: the file cannot be read.
        ValueError: there can be no file of that name.
    """
    builder = ET.TreeBuilder(insert_comments=with_comments, insert_pis=with_comments)
    # expat bounds the growth of entities
    parser = ET.XMLParser(target=builder, encoding="utf-8")  # noqa: S314
    root = ET.fromstring(file.read_bytes(), parser)  # noqa: S314
    for part in root.iter():
        if isinstance(part.tag, str):
            part.tag = part.tag.rpartition("}")[2]
    return root
