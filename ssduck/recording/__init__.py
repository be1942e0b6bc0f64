"""Keeping the ticks of worlds, and going back to them.

`spec` defines what is kept. A `Recorder` gets each tick, copies its rows into `buffers`, and hands
them to one of the `stores`, in a thread (`background_writer`). `replay` reads them: as rows, as
entities, and as whole worlds.
"""

from typing import TYPE_CHECKING

from ssduck.lazy import exports

if TYPE_CHECKING:
    from ssduck.recording.episode import Episode
    from ssduck.recording.export import exported
    from ssduck.recording.recorder import Recorder
    from ssduck.recording.replay.past import Past
    from ssduck.recording.replay.record import Record
    from ssduck.recording.spec import Recording

__all__ = [
    "Episode",
    "Past",
    "Record",
    "Recorder",
    "Recording",
    "exported",
]

__getattr__, __dir__ = exports(
    __name__,
    {
        "episode": ("Episode",),
        "export": ("exported",),
        "recorder": ("Recorder",),
        "replay.past": ("Past",),
        "replay.record": ("Record",),
        "spec": ("Recording",),
    },
)
