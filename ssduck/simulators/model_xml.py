"""Reads model files as XML as simulators do: in UTF-8, and without namespaces."""

from __future__ import annotations

import re
from xml.etree import ElementTree as ET
from xml.parsers import expat

# What expat refuses and simulators read over: comments with --, and declarations anywhere.
_READ_OVER = re.compile(r"<!--.*?-->|<\?.*?\?>", re.DOTALL)
_BARE = re.compile(r"&(?!(?:amp|lt|gt|quot|apos|#\w+);)")


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


def parse_tolerantly(content: bytes) -> tuple[ET.Element, bool]:
    """Returns the root of a model file's content as PyBullet reads it; prefixes stay in names.

    It takes prefixes without a namespace, comments with `--`, declarations anywhere, a single `&`,
    other encodings than UTF-8, and anything behind a null character, as PyBullet does.

    Args:
        content: the bytes of the model file.

    Returns:
        The root, and whether it took more than plain XML in UTF-8.

    Raises:
        ET.ParseError: it is no XML even so.
    """
    try:
        return _parsed(content), False
    except expat.ExpatError:
        pass
    content = content.partition(b"\0")[0]  # texts of C end there
    try:
        text = content.decode("utf-8-sig")
    except UnicodeDecodeError:
        text = content.decode("latin-1")
    text = _READ_OVER.sub(lambda found: "\n" * found[0].count("\n"), text)
    try:
        return _parsed(_BARE.sub("&amp;", text).lstrip().encode()), True
    except expat.ExpatError as error:
        raise ET.ParseError(str(error)) from error


def _parsed(content: bytes) -> ET.Element:
    """Parses XML without namespaces.

    Raises:
        expat.ExpatError: it is no XML in UTF-8.
    """
    builder = ET.TreeBuilder()
    parser = expat.ParserCreate("utf-8")  # expat bounds the growth of entities
    parser.buffer_text = True
    parser.StartElementHandler = builder.start
    parser.EndElementHandler = builder.end
    parser.CharacterDataHandler = builder.data
    parser.Parse(content, True)
    return builder.close()
