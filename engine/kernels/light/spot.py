"""The cone of spot lamps: a factor on the light of a point, sphere or disk."""

from __future__ import annotations

from ..geom.vec import ONE, THREE, TWO, ZERO, normalize
from ..jit import device
from ..simd import at, select
from ..tables import SPOT_DROP, SPOT_SCALE, TO_LOCAL


@device
def spot_falloff(lamps, i, w):
    """Smoothstep over the rim of the cone, for light that leaves along w. The angle is measured in the lamp's own
    space, where its scale makes an elliptic cone round (Cycles, kernel/light/spot.h)."""
    local = normalize(
        (
            at(lamps, i, TO_LOCAL) * w[0] + at(lamps, i, TO_LOCAL + 1) * w[1] + at(lamps, i, TO_LOCAL + 2) * w[2],
            at(lamps, i, TO_LOCAL + 3) * w[0] + at(lamps, i, TO_LOCAL + 4) * w[1] + at(lamps, i, TO_LOCAL + 5) * w[2],
            at(lamps, i, TO_LOCAL + 6) * w[0] + at(lamps, i, TO_LOCAL + 7) * w[1] + at(lamps, i, TO_LOCAL + 8) * w[2],
        )
    )
    # 1 - cos of the angle off the axis, which is local -z: a narrow cone's cosines are all 1 in float32.
    x, y, z = local
    drop = select(z < ZERO, (x * x + y * y) / (ONE - z), ONE + z)
    s = min(max((at(lamps, i, SPOT_DROP) - drop) * at(lamps, i, SPOT_SCALE), ZERO), ONE)
    return s * s * (THREE - TWO * s)
