"""Writes pictures as PNG, GIF or MP4; a file is complete or not there."""

from __future__ import annotations

import subprocess
from collections.abc import Iterator
from contextlib import suppress
from itertools import chain, count, pairwise
from pathlib import Path
from shutil import which
from typing import Any

from PIL import Image

from ssduck.adapters.optional import library
from ssduck.errors import ArgumentError, UnsupportedError, nearest
from ssduck.recording.stores.atomic_files import write_atomically
from ssduck.render.canvas import Picture

# The colours of a picture of a GIF.
GIF_COLOURS = 160
# Browsers show a GIF with more pictures a second ten times as slowly.
MAX_GIF_RATE = 50.0
_FFMPEG = "-f rawvideo -pix_fmt rgb24 -s {size} -r {rate} -i - -an -vcodec libx264 -pix_fmt yuv420p"
_QUALITY = "-crf 18 -movflags +faststart -f mp4 -y"


def check_format(path: Path, size: tuple[int, int], fps: float) -> None:
    """Checks whether a file of that name can have pictures of that size and rate."""
    suffix = path.suffix.lower()
    if suffix not in _WRITERS:
        hint = nearest(suffix, _WRITERS) or list(_WRITERS)
        raise ArgumentError(
            f"render: {path.name} does not end in .png, .gif or .mp4", suggestions=hint
        )
    if not path.parent.is_dir():
        raise ArgumentError(f"render: there is no folder {path.parent}")
    if suffix == ".mp4" and (size[0] % 2 or size[1] % 2):
        raise ArgumentError(f"render: the size of an MP4 is even, not {size[0]} x {size[1]}")
    if suffix == ".gif" and fps > MAX_GIF_RATE:
        raise ArgumentError(f"render: a GIF has at most {MAX_GIF_RATE:g} pictures a second")
    if suffix == ".mp4":
        _ffmpeg()


def write_film(path: Path, pictures: Iterator[Picture], fps: float) -> None:
    """Writes pictures to a file, in place of one that exists.

    Args:
        path: the file; its suffix tells the format. A PNG has the last picture.
        pictures: of the same size; at least one.
        fps: the pictures a second.
    """
    writer = _WRITERS[path.suffix.lower()]
    write_atomically(path, lambda unfinished: writer(unfinished, pictures, fps))


def _write_png(path: Path, pictures: Iterator[Picture], fps: float) -> None:  # noqa: ARG001
    picture = None
    for picture in pictures:  # noqa: B007
        pass
    assert picture is not None
    Image.fromarray(picture).save(path, "PNG", optimize=True)


def _write_gif(path: Path, pictures: Iterator[Picture], fps: float) -> None:
    durations: list[int] = []
    images = _gif_images(pictures, fps, durations)
    first = next(images)
    # Pillow takes image by image, and keeps a copy of each.
    first.save(path, "GIF", save_all=True, append_images=images, duration=durations, loop=0)


def _gif_images(
    pictures: Iterator[Picture], fps: float, durations: list[int]
) -> Iterator[Image.Image]:
    """Yields pictures with the colours of a GIF, and adds the duration of each before, ms.

    The durations are whole hundredths of a second, whose sum is that of the film.
    """
    ends = (round(100 * number / fps) for number in count())
    for picture, (start, end) in zip(pictures, pairwise(ends), strict=False):
        durations.append(10 * (end - start))
        yield Image.fromarray(picture).quantize(
            GIF_COLOURS, Image.Quantize.FASTOCTREE, dither=Image.Dither.NONE
        )


def _write_mp4(path: Path, pictures: Iterator[Picture], fps: float) -> None:
    first = next(pictures)
    height, width = first.shape[:2]
    options = _FFMPEG.format(size=f"{width}x{height}", rate=fps).split() + _QUALITY.split()
    command = [_ffmpeg(), "-loglevel", "error", *options, str(path)]
    with subprocess.Popen(  # noqa: S603  # the options are ours; the path is an argument of its own
        command, stdin=subprocess.PIPE, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE
    ) as process:
        assert process.stdin is not None
        assert process.stderr is not None
        try:
            for picture in chain((first,), pictures):
                process.stdin.write(picture.tobytes())
            process.stdin.close()
            said = process.stderr.read().decode(errors="replace").strip()
        except BrokenPipeError:
            said = process.stderr.read().decode(errors="replace").strip()
            with suppress(OSError):
                process.stdin.close()
        except BaseException:
            process.kill()
            with suppress(OSError):
                process.stdin.close()
            raise
    if process.returncode:
        raise OSError(f"ffmpeg could not write the film: {said}")


def _ffmpeg() -> str:
    """Returns the path of the ffmpeg of the system, or else of imageio-ffmpeg."""
    found = which("ffmpeg")
    if found is not None:
        return found
    try:
        return str(library("imageio_ffmpeg", "render").get_ffmpeg_exe())
    except (UnsupportedError, RuntimeError) as error:
        raise UnsupportedError(
            "an MP4 needs ffmpeg: install it, or pip install 'ssduck[render]'"
        ) from error


_WRITERS: dict[str, Any] = {".png": _write_png, ".gif": _write_gif, ".mp4": _write_mp4}
