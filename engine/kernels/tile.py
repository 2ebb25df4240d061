"""Which kernel renders a scene, and the memory that a thread brings along for it."""

from __future__ import annotations

import numpy as np

from ..features import Features
from .batch import new_batch
from .path import make_path_kernel, new_path
from .staged import covers, make_staged_kernel


def make_tile_kernel(features: Features):
    """The kernel that renders a tile of scenes with these features. Compiled, or read from disk, at its first call."""
    return make_staged_kernel(features) if covers(features) else make_path_kernel(features)


def new_memory(features: Features, lamp_count: int = 0) -> np.ndarray:
    """A thread's memory for that kernel, in a scene where rays may meet so many lamps."""
    new = new_batch if covers(features) else new_path
    return new(lamp_count, features.light_passes)
