"""Success and reward of gymnasium's environments as queries: `QueryWrapper`, `score`, `make_task`.

`ssduck.gym` needs gymnasium: `pip install 'ssduck[gym]'`.
"""

from ssduck.gym.scoring import EpisodeScore, score
from ssduck.gym.tasks import make_task
from ssduck.gym.wrapper import QueryWrapper

__all__ = ["EpisodeScore", "QueryWrapper", "make_task", "score"]
