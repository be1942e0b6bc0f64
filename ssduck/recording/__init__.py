"""Records the ticks of worlds and replays them.

`spec` defines what is recorded. A `Recorder` gets each tick, copies its rows into `buffers` and
passes them to one of the `stores` in a thread (`background_writer`). `replay` reads them back: as
rows, as entities and as whole worlds.
"""

from typing import TYPE_CHECKING

from ssduck.lazy import exports

if TYPE_CHECKING:
    from ssduck.recording.episode import Episode
    from ssduck.recording.export import export
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
    "export",
]

__getattr__, __dir__ = exports(
    __name__,
    {
        "episode": ("Episode",),
        "export": ("export",),
        "recorder": ("Recorder",),
        "replay.past": ("Past",),
        "replay.record": ("Record",),
        "spec": ("Recording",),
    },
)
