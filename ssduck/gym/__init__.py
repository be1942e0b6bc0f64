"""Success and reward of gymnasium's environments as queries: `QueryWrapper`, `score`, `make_task`.

`QueryWrapper` and `make_task` need gymnasium: `pip install 'ssduck[gym]'`. `score` does not.
"""

from typing import TYPE_CHECKING

from ssduck.lazy import exports

if TYPE_CHECKING:
    from ssduck.gym.scoring import EpisodeScore, score
    from ssduck.gym.tasks import make_task
    from ssduck.gym.wrapper import QueryWrapper

__all__ = ["EpisodeScore", "QueryWrapper", "make_task", "score"]

__getattr__, __dir__ = exports(
    __name__,
    {
        "scoring": ("EpisodeScore", "score"),
        "tasks": ("make_task",),
        "wrapper": ("QueryWrapper",),
    },
)
