"""Motors of joints: `Entity.drive`."""

from __future__ import annotations

import numpy as np
import pytest
from conftest import collision, joint, link, robot

import ssduck
from ssduck.errors import (
    ArgumentError,
    RemovedEntityError,
    StateError,
    UnknownNameError,
    UnsupportedError,
)
