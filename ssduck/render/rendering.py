"""Draws a world, a scene or a record as PNG, GIF or MP4: `render`, and `filmed` a world in use.

A file is complete or not there.
"""

from __future__ import annotations

import contextlib
import math
import subprocess
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from itertools import chain, count, pairwise
from pathlib import Path
from shutil import which
from typing import Any

import numpy as np
from PIL import Image

from ssduck import validation
from ssduck.adapters.display import display_table
from ssduck.adapters.marks import Mark, marks_of
from ssduck.adapters.optional import library
from ssduck.errors import (
    ArgumentError,
    ProgramWarning,
    UnknownNameError,
    UnsupportedError,
    nearest,
    warn,
)
from ssduck.formatting import short_repr
from ssduck.geometry.arrays import Array
from ssduck.interpreter.completion import Language
from ssduck.interpreter.interpreter import Interpreter
from ssduck.interpreter.opening import open_record
from ssduck.interpreter.program import rows_to_show
from ssduck.logic.why import Why
from ssduck.recording.paths import is_record
from ssduck.recording.replay.replayed_world import ReplayedWorld
from ssduck.recording.stores.files import write_atomically
from ssduck.render.canvas import Canvas, Picture
from ssduck.render.overlays import with_parts
from ssduck.render.stage import Stage
from ssduck.simulators.clock import TIME_TOLERANCE
from ssduck.simulators.scenes import Camera, find_scene
from ssduck.view.frames import Frame
from ssduck.world.world import World

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
    """Yields pictures with the colours of a GIF, and adds the duration of each before, ms."""
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
            with suppress(BrokenPipeError):  # it has ended, and says why
                for picture in chain((first,), pictures):
                    process.stdin.write(picture.tobytes())
            with suppress(BrokenPipeError):
                process.stdin.close()
            said = process.stderr.read().decode(errors="replace").strip()
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


# -- worlds, scenes and records ---------------------------------------------------------------


# The seconds of a scene that a film shows unless it says otherwise.
SECONDS = 5.0
MAX_PICTURES = 100_000
# The least number of pictures a second.
MIN_FPS = 0.001


@dataclass(frozen=True)
class Film:
    """What is drawn, and how.

    Attributes:
        span: the simulated times of the first and the last picture, s; None for all of a record or
            the first seconds of a scene, and for its last or first tick in a PNG.
        speed: simulated seconds a second of the film.
        fps: pictures a second of the film.
        size: width and height, pixels.
        camera: the camera; None for that of the world.
        highlight: a query, asked at each picture; the entities and links of its result stand out.
            The parts of a WHY are drawn: nearest points, and margins. A PNG of a record without a
            span shows the tick that decides.
        language: the language of the query.

    Raises:
        ArgumentError: a number is not positive, or the span is empty.
    """

    span: tuple[float, float] | None = None
    speed: float = 1.0
    fps: float = 30.0
    size: tuple[int, int] = (1280, 720)
    camera: Camera | None = None
    highlight: str | None = None
    language: Language = "selectscript"

    def __post_init__(self) -> None:
        validation.positive_number(self.speed, "render: speed", "positive speed")
        validation.positive_number(self.fps, "render: fps", "positive number of pictures a second")
        if self.fps < MIN_FPS:
            raise ArgumentError(f"render: fps is at least {MIN_FPS:g}, not {self.fps:g}")
        validation.picture_size(*self.size, "render")
        if self.span is not None and not self.span[0] <= self.span[1] < math.inf:
            raise ArgumentError(
                f"render: the span ends before it starts: {self.span[0]:g} s to {self.span[1]:g} s"
            )

    def times(self, start: float, end: float) -> Array:
        """Returns the simulated times of the pictures from one time to another, s."""
        last = (end - start) * self.fps / self.speed + 1e-6
        if not last < MAX_PICTURES:
            raise ArgumentError(
                f"render: {last + 1:,.0f} pictures are more than {MAX_PICTURES:,}; choose a "
                "shorter span, a higher speed or fewer pictures a second"
            )
        times = start + np.arange(math.floor(last) + 1, dtype=np.float64) * (self.speed / self.fps)
        return np.asarray(times, dtype=np.float64)


def render(
    source: Interpreter | World | str | Path,
    path: str | Path,
    film: Film | None = None,
    *,
    episode: int | None = None,
    on_picture: Callable[[int, int], object] | None = None,
) -> Path:
    """Draws a world, a scene or a record, without a screen, and returns the path of the file.

    A PNG shows a moment, a GIF or an MP4 a film. A scene is loaded and stepped; of a record, each
    picture shows the last tick at or before its time. A world in use is drawn as it is now, as a
    PNG: to make a film of it, record it.

    Args:
        source: an interpreter with one world, a world, the name or path of a scene, or the path of
            a record.
        path: the file, which ends in .png, .gif or .mp4.
        film: what is drawn, and how.
        episode: the number of the episode of a record; None for the last one.
        on_picture: a function that gets the number of each picture and their count, for progress.

    Raises:
        ArgumentError: the suffix, the span, the size or another value is wrong.
        SelectScriptError: the query is wrong, or the scene or record cannot be opened.
        UnsupportedError: the extra `render`, OpenGL or ffmpeg is missing.
        OSError: the file cannot be written.
    """
    film, path = film or Film(), Path(path)
    check_format(path, film.size, film.fps)
    with contextlib.ExitStack() as stack:
        take = _take(stack, source, path, film, episode)
        canvas = Canvas(*film.size)
        stack.callback(canvas.close)
        pictures = _pictures(take, canvas, film, on_picture)
        write_film(path, pictures, film.fps)
    return path


@contextlib.contextmanager
def filmed(world: World, path: str | Path, film: Film | None = None) -> Iterator[None]:
    """Films a world in use: what it does while the context is open.

    The world takes a tick for each picture. The pictures are drawn at the end, if no error was
    raised.

    Args:
        world: the world.
        path: the file, which ends in .gif or .mp4; or .png for the last moment.
        film: how it is drawn; without a span, and without a query, as the world has moved on when
            the pictures are drawn.

    Raises:
        ArgumentError: the suffix or the size is wrong, or there is a span or a query.
        UnsupportedError: the extra `render`, OpenGL or ffmpeg is missing.
        OSError: the file cannot be written.
    """
    film, path = film or Film(), Path(path)
    check_format(path, film.size, film.fps)
    if film.span is not None or film.highlight is not None:
        raise ArgumentError("filmed: a world in use is filmed without a span and without a query")
    camera_operator = _Operator(film)
    with contextlib.closing(Canvas(*film.size)) as canvas:
        world.follow(camera_operator)
        try:
            camera_operator.ticked(world)
            yield
        finally:
            world.unfollow(camera_operator)
        drawing = _Drawing(canvas, film)
        pictures = (drawing.picture(world, frame, []) for frame in camera_operator.frames)
        write_film(path, pictures, film.fps)


class _Operator:
    """Keeps the frames of a world for a film."""

    def __init__(self, film: Film) -> None:
        self.frames: list[Frame] = []
        self._interval = film.speed / film.fps
        self._next = -math.inf

    def due(self, _world: Any, /) -> float:
        """Returns the time of the next picture, s."""
        return self._next

    def ticked(self, world: Any, /) -> None:
        """Keeps the frame of a tick, for all pictures that are due."""
        with world.lock:
            frame = Frame.of(world.snapshot)
        if self._next == -math.inf or frame.time < self.frames[-1].time:
            self._next = frame.time  # the first one, or a new episode
        while self._next <= frame.time + 1e-9:
            self.frames.append(frame)
            self._next += self._interval
            if len(self.frames) > MAX_PICTURES:
                raise ArgumentError(f"filmed: there are more than {MAX_PICTURES:,} pictures")


@dataclass(frozen=True, eq=False)
class _Take:
    """A world, the times at which it is drawn, s, and what moves it to one of them."""

    ss: Interpreter
    world: World
    times: Array
    go: Callable[[float], object]


def _take(
    stack: contextlib.ExitStack,
    source: Interpreter | World | str | Path,
    path: Path,
    film: Film,
    episode: int | None,
) -> _Take:
    is_picture = path.suffix.lower() == ".png"
    if isinstance(source, Interpreter | World):
        if not is_picture or film.span is not None:
            raise ArgumentError(
                "render: a world in use is drawn as it is now, as a PNG; record it with record_to, "
                "and render the record"
            )
        return _present(stack, source)
    if is_record(source):
        return _replay(stack, source, film, episode, is_picture=is_picture)
    if episode is not None:
        raise ArgumentError(f"render: {source} is no record, so it has no episodes")
    return _simulation(stack, source, film, is_picture=is_picture)


def _present(stack: contextlib.ExitStack, source: Interpreter | World) -> _Take:
    if isinstance(source, World):
        ss, world = stack.enter_context(Interpreter(recording=None)), source
        ss.add_variable(world.name, world)
    else:
        if len(source.worlds) != 1:
            names = ", ".join(each.name for each in source.worlds) or "none"
            raise UnknownNameError(f"render: pass one of the worlds of the interpreter: {names}")
        ss, world = source, source.worlds[0]
    return _Take(ss, world, np.array([world.time]), lambda _: None)


def _replay(
    stack: contextlib.ExitStack,
    path: str | Path,
    film: Film,
    episode: int | None,
    *,
    is_picture: bool,
) -> _Take:
    ss = stack.enter_context(contextlib.closing(open_record(path, episode=episode)))
    world = ss.worlds[0]
    assert isinstance(world, ReplayedWorld)
    ticks = world.ticker.record.ticks.times
    first, last = float(ticks[0]), float(ticks[-1])
    start, end = film.span or ((last, last) if is_picture else (first, last))
    if end < first or start > last:
        raise ArgumentError(
            f"render: the record has ticks from {first:g} s to {last:g} s, none from {start:g} s "
            f"to {end:g} s"
        )
    start, end = max(start, first), min(end, last)
    times = np.array([end]) if is_picture else film.times(start, end)
    return _Take(ss, world, times, world.seek)


def _simulation(
    stack: contextlib.ExitStack, scene: str | Path, film: Film, *, is_picture: bool
) -> _Take:
    ss = stack.enter_context(Interpreter(recording=None))
    loaded = find_scene(scene)
    world = stack.enter_context(contextlib.closing(World.load(loaded)))
    world.name = loaded.name
    ss.add_variable(world.name, world)
    start, end = film.span or (0.0, 0.0 if is_picture else SECONDS)
    if start < 0:
        raise ArgumentError(f"render: a scene begins at 0 s, not at {start:g} s")

    def go(time: float) -> None:
        steps = round((time - world.time) / world.simulator.timestep)
        if steps > 0:
            world.step(steps)

    return _Take(ss, world, np.array([end]) if is_picture else film.times(start, end), go)


def _pictures(
    take: _Take, canvas: Canvas, film: Film, on_picture: Callable[[int, int], object] | None
) -> Iterator[Picture]:
    drawing, query = _Drawing(canvas, film), _Query(take, film)
    for number, time in enumerate(take.times.tolist(), 1):
        take.go(time)
        with take.world.lock:
            marks, why = query.answer()
            is_chosen = film.span is not None or len(take.times) > 1
            if not is_chosen and why is not None and why.decided_at is not None:
                take.go(why.decided_at)
            frame = Frame.of(take.world.snapshot)
        parts = [] if why is None else _parts_at(why, frame.time)
        yield drawing.picture(take.world, frame, marks, parts)
        if on_picture is not None:
            on_picture(number, len(take.times))
    query.warn_if_unseen()


def _parts_at(why: Why, time: float) -> list[Why]:
    """Returns the parts of a condition that have points, and are of a tick."""
    times = ((part, time if part.time is None else part.time) for _, part in why.walk())
    return [part for part, at in times if part.points and abs(at - time) < TIME_TOLERANCE]


class _Drawing:
    """Draws the frames of a world."""

    def __init__(self, canvas: Canvas, film: Film) -> None:
        self._canvas, self._camera = canvas, film.camera
        self._stage: Stage | None = None

    def picture(
        self, world: World, frame: Frame, marks: list[Mark], parts: Sequence[Why] = ()
    ) -> Picture:
        """Returns the picture of a frame with its marks, and with parts of a condition over it."""
        canvas, stage = self._canvas, self._stage
        if stage is None or not stage.frame.has_same_scene(frame):
            with world.lock:
                self._stage = stage = Stage.of(world, frame)
            canvas.set_shapes(stage.geometries)
        matrices = stage.matrices(frame)
        low, high = stage.bounds(matrices)
        if self._camera is None:
            self._camera = world.camera
        picture = canvas.draw(matrices, stage.highlighted(marks), self._camera, low, high)
        return with_parts(picture, parts, self._camera) if parts else picture


class _Query:
    """The query whose result stands out."""

    def __init__(self, take: _Take, film: Film) -> None:
        self._take, self._film = take, film
        self._compiled = None
        # Whether something stood out; the last answer with rows, where nothing did.
        self._has_marks, self._unseen = False, ""
        if film.highlight is not None and film.language == "selectscript":
            self._compiled = take.ss.compile(film.highlight)

    def answer(self) -> tuple[list[Mark], Why | None]:
        """Returns the entities and links in the result at the present tick, and the WHY it is."""
        if self._film.highlight is None:
            return [], None
        ss = self._take.ss
        if self._compiled is not None:
            value: Any = rows_to_show(self._compiled, ss)
        else:
            value = ss.sql(self._film.highlight)
        rows = display_table(value).rows
        found = marks_of(self._take.world, rows)
        self._has_marks = self._has_marks or bool(found)
        if rows and not found:
            self._unseen = short_repr(list(rows) if self._compiled is None else value)
        return found, value if isinstance(value, Why) else None

    def warn_if_unseen(self) -> None:
        """Warns if the query was asked, and nothing stood out in any picture."""
        if self._film.highlight is None or self._has_marks:
            return
        reason, world = "has no rows", self._take.world.name
        if self._unseen:
            reason = (
                f"answers {self._unseen}, which has no entity and no link of {world!r}, by itself "
                "or by name: let it be a query for obj"
            )
        pictures = "the picture" if len(self._take.times) == 1 else "any picture"
        warn(
            f"highlight: nothing stands out in {pictures}: {short_repr(self._film.highlight)} "
            f"{reason}",
            ProgramWarning,
        )
