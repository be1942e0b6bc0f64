"""A robot that plans its motions: an example application, which only `ssduck demo cleanup` uses.

`Cleaner` takes cups from one place to another. It plans in the spaces of `spaces`, by the
algorithms of `planning`, for the links of `kinematics` among the shapes of `obstacles`;
`driving` follows the paths by motors.
"""

from __future__ import annotations

from ssduck.demos.motion.cleaner import Cleaner, Failed

__all__ = ["Cleaner", "Failed"]
