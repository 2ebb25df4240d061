"""The choice between the three groups of emitters: local ones, suns, and the world's image.

By what each sends to the point, as Cycles' light tree weighs its distant lights against the others
(kernel/light/tree.h). Shadows are in none of the estimates: so no group that can light the point at all counts for
less than a part of the strongest, lest a sun behind a roof leaves the lamps beneath it to chance.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ...features import IMAGE_WORLD, NO_EMITTER
from ..geom.vec import LARGE, ONE, TINY, ZERO
from ..jit import device
from ..simd import select
from ..tables import WORLD_IRRADIANCE
from .sun import suns_importance
from .tree import tree_importance

# The least that a group counts for, as a part of the strongest: between 1/4, which gains more where one group is most
# of the light, and 1/2, which loses less where all of that light is in shadow. The trial "lamps, suns and world chosen
# by what each sends" of benchmarks/trials.py has what the choice gains.
LEAST_SHARE = np.float32(1 / 3)
# Two bands of spherical harmonics may turn negative: the least irradiance of the world, as a part of its mean.
LEAST_IRRADIANCE = np.float32(0.1)


class Shares(NamedTuple):
    """Probabilities of the groups at a point."""

    local: np.float32
    suns: np.float32
    world: np.float32


@device
def _world_importance(lights, n):
    w = lights.world
    mean = w[WORLD_IRRADIANCE]
    slope = w[WORLD_IRRADIANCE + 1] * n[0] + w[WORLD_IRRADIANCE + 2] * n[1] + w[WORLD_IRRADIANCE + 3] * n[2]
    return max(mean + slope, LEAST_IRRADIANCE * mean)


@device
def group_shares(f, lights, tree, p, n):
    """`Shares` at the point p with normal n. A single group costs nothing: its share is the constant 1."""
    has_local, has_world = f.emitter_choice != NO_EMITTER, f.world == IMAGE_WORLD
    local, suns, world = ONE if has_local else ZERO, ONE if f.suns else ZERO, ONE if has_world else ZERO
    if has_local + f.suns + has_world > 1:
        local = min(tree_importance(tree, p, n), LARGE) if has_local else ZERO
        suns = min(suns_importance(lights.suns, n), LARGE) if f.suns else ZERO
        world = min(_world_importance(lights, n), LARGE) if has_world else ZERO
        least = LEAST_SHARE * max(local, max(suns, world))
        local = select(local > ZERO, max(local, least), ZERO)
        suns = select(suns > ZERO, max(suns, least), ZERO)
        world = select(world > ZERO, max(world, least), ZERO)
        total = local + suns + world
        dark = total <= TINY
        local, suns = select(dark, ZERO, local / total), select(dark, ZERO, suns / total)
        world = select(dark, ZERO, world / total)
    return Shares(local, suns, world)
