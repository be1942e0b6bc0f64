"""Programs in whose text the part that is told of is marked."""


def unmarked(text):
    """A program without its marks « and », and the part between them; None where there are none."""
    before, mark, rest = text.partition("«")
    part, _, after = rest.partition("»")
    return before + part + after, part if mark else None
