"""Success and reward of gymnasium's environments as queries: `QueryWrapper`, `score`, `make_task`.

`VectorQueryWrapper` has many environments at once, and `BatchTerms` states in arrays. The wrappers
and `make_task` need gymnasium: `pip install 'ssduck[gym]'`. `score` and `BatchTerms` do not.
"""

from typing import TYPE_CHECKING

from ssduck.lazy import exports

if TYPE_CHECKING:
    from ssduck.gym.batch_terms import BatchJudgement, BatchTerms
    from ssduck.gym.scoring import EpisodeScore, score
    from ssduck.gym.tasks import make_task
    from ssduck.gym.vector_wrapper import VectorQueryWrapper
    from ssduck.gym.wrapper import QueryWrapper

__all__ = [
    "BatchJudgement",
    "BatchTerms",
    "EpisodeScore",
    "QueryWrapper",
    "VectorQueryWrapper",
    "make_task",
    "score",
]

__getattr__, __dir__ = exports(
    __name__,
    {
        "batch_terms": ("BatchJudgement", "BatchTerms"),
        "scoring": ("EpisodeScore", "score"),
        "tasks": ("make_task",),
        "vector_wrapper": ("VectorQueryWrapper",),
        "wrapper": ("QueryWrapper",),
    },
)
