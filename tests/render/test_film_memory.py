"""The pictures of a GIF are written one by one: a film may have thousands."""

import weakref

import numpy as np
from PIL import Image

from ssduck.render.rendering import write_film

COUNT, FPS = 30, 12.0


def test_a_gif_keeps_no_pictures(tmp_path, monkeypatch):
    """The library keeps copies of its own, of fewer bytes."""
    made, alive = [], []
    quantize = Image.Image.quantize

    def noted(image, *arguments, **options):
        result = quantize(image, *arguments, **options)
        made.append(weakref.ref(result))
        return result

    monkeypatch.setattr(Image.Image, "quantize", noted)

    def pictures():
        for number in range(COUNT):
            alive.append(sum(ref() is not None for ref in made))
            yield np.full((4, 6, 3), 8 * number, dtype=np.uint8)

    path = tmp_path / "film.gif"
    write_film(path, pictures(), FPS)
    assert len(made) == COUNT
    assert max(alive) <= 3
    with Image.open(path) as gif:
        assert gif.n_frames == COUNT
        durations = []
        for number in range(COUNT):
            gif.seek(number)
            durations.append(gif.info["duration"])
            assert np.abs(np.asarray(gif.convert("RGB")).astype(int) - 8 * number).max() <= 4
    assert sum(durations) == round(1000 * COUNT / FPS)
