"""Reads model files as XML as simulators do: in UTF-8, and without namespaces."""

from __future__ import annotations

from xml.etree import ElementTree as ET


def parse_xml(content: bytes, *, with_comments: bool = False) -> ET.Element:
    """Returns the root of a model file's content; the names of elements are without namespaces.

    MuJoCo and PyBullet know neither encodings nor namespaces: `<include xmlns="a"/>` is an include.

    Args:
        content: the bytes of the model file.
        with_comments: whether comments and processing instructions inside the root are children,
            too; their tags are functions.

    Raises:
        ET.ParseError: it is no XML in UTF-8.
    """
    builder = ET.TreeBuilder(insert_comments=with_comments, insert_pis=with_comments)
    # expat bounds the growth of entities
    parser = ET.XMLParser(target=builder, encoding="utf-8")  # noqa: S314
    root = ET.fromstring(content, parser)  # noqa: S314
    for part in root.iter():
        if isinstance(part.tag, str):
            part.tag = part.tag.rpartition("}")[2]
    return root
