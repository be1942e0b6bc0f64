"""What a worker opens, and the files that it may read for that."""

from __future__ import annotations

import glob
import tempfile
from collections.abc import Iterable, Mapping
from contextlib import ExitStack
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, Literal, Self

from ssduck.errors import SandboxError, SceneError
from ssduck.recording.paths import expand_path
from ssduck.recording.spec import Recording
from ssduck.recording.stores.object_store import ObjectPath, fetch
from ssduck.simulators.scenes import scene_file, shipped_scenes

# A folder with more entries than that is no scene's.
_MAX_ENTRIES = 500


@dataclass(frozen=True)
class Source:
    """What a worker opens.

    Attributes:
        kind: a scene, a record, a lake, a task, or nothing.
        location: the name of a shipped scene, or an absolute path.
        options: arguments of `load`, `open` or `Interpreter`.
        readable: the files and folders that this takes.
        fetched: the folder with what was fetched from an object store, or with links to a record;
            `close` removes it.
    """

    kind: Literal["scene", "record", "lake", "task", "nothing"] = "nothing"
    location: str = ""
    options: Mapping[str, Any] = field(default_factory=dict)
    readable: tuple[str, ...] = ()
    fetched: Any = None

    @classmethod
    def of_scene(
        cls,
        scene: str | Path,
        *,
        recording: Recording | Literal["default"] | None = "default",
        simulator: str | None = None,
        name: str | None = None,
    ) -> Self:
        """Returns a scene, for the arguments of `ssduck.load`.

        Of the folder of its file all can be read that is not hidden.
        """
        plain = asdict(recording) if isinstance(recording, Recording) else recording
        options = {"simulator": simulator, "name": name, "recording": plain}
        path = scene_file(Path(scene).expanduser()).absolute()
        if str(scene) in shipped_scenes() or not path.exists():  # which is an error there
            return cls("scene", str(scene), options)
        return cls("scene", str(path), options, _with_folder(path))

    @classmethod
    def of_record(
        cls,
        path: str | Path,
        world: str | None = None,
        episode: int | None = None,
        *,
        partial: bool = False,
    ) -> Self:
        """Returns a record, for the arguments of `ssduck.open`.

        The objects of one in an object store are fetched into a temporary folder.

        Raises:
            RecordError: the objects cannot be read.
        """
        place, folder = expand_path(path), None
        if isinstance(place, ObjectPath):
            with ExitStack() as stack:
                folder = tempfile.TemporaryDirectory(prefix="ssduck-record-")
                stack.callback(folder.cleanup)
                place = fetch(place, Path(folder.name))
                stack.pop_all()
        place = place.absolute()
        real = place.resolve()
        if glob.has_magic(str(place)):  # DuckDB would list the folder around it
            folder = folder or tempfile.TemporaryDirectory(prefix="ssduck-record-")
            place = Path(folder.name, f"link{place.suffix}")
            for end in ("", ".wal"):
                Path(f"{place}{end}").symlink_to(f"{real}{end}")
        options = {"world": world, "episode": episode, "partial": partial}
        own = (str(real), *_without_links([Path(f"{real}.wal")]))
        return cls("record", str(place), options, own, folder)

    def close(self) -> None:
        """Removes what was fetched."""
        if self.fetched is not None:
            self.fetched.cleanup()

    @classmethod
    def of_task(cls, path: Path) -> Self:
        """Returns a task, by the absolute path of its file, which reads the folder of it."""
        return cls("task", str(path), readable=_with_folder(path))


def absolute(paths: Iterable[str | Path]) -> tuple[str, ...]:
    """Returns absolute paths."""
    return tuple(str(Path(path).expanduser().absolute()) for path in paths)


def _with_folder(path: Path) -> tuple[str, ...]:
    """Returns a file, and what is in its folder, without hidden files and links."""
    folder, file = path.parent.resolve(), path.resolve()
    if not file.is_relative_to(folder):
        raise SceneError(f"{path} is a link that leads out of its folder: give {file} itself")
    if not folder.is_dir():
        return (str(file),)
    entries = _without_links(sorted(folder.iterdir()))
    if len(entries) > _MAX_ENTRIES:
        raise SandboxError(
            f"{folder} has more than {_MAX_ENTRIES} entries, all of which a scene could read; put "
            "the scene and its models into a folder of their own"
        )
    return (str(file), *entries)


def _without_links(paths: Iterable[Path]) -> list[str]:
    """Returns paths without hidden ones, and without links: a stranger says where they lead."""
    return [str(one) for one in paths if not (one.name.startswith(".") or one.is_symlink())]
