"""Success and reward of gymnasium's environments as queries: `QueryWrapper`, `score`.

`ssduck.gym` needs gymnasium: `pip install 'ssduck[gym]'`.
"""

from ssduck.gym.scoring import EpisodeScore, score
from ssduck.gym.wrapper import QueryWrapper

__all__ = ["EpisodeScore", "QueryWrapper", "score"]
