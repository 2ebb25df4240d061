"""Two endless plates, one facing the other, that emit and reflect with both lobes: many bounces in closed form.

A ray meets the other plate at the angle at which it left this one, so what a point shows depends on that angle alone:

    L_0(theta) = Le
    L_k+1(theta) = Le + integral of f(theta, wi) L_k(theta_i) cos theta_i dwi

which is a matrix over Gauss's nodes in cos theta_i, once f is averaged over the azimuth. The diffuse and the glossy
part of f are matrices of their own, so that bounces of either kind may be counted.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache

import numpy as np
import scenes

from engine.scene import Material, Scene

NODES, TURNS = 160, 256
ENDLESS = 300  # bounces, when less than 0.9 of the light comes back from each
HALF = 1e4  # of a plate's side; the plates are 1 apart


@dataclass(frozen=True)
class Slab:
    """Reflectances and exponent of both plates, and the angle to the normal at which one is seen."""

    kd: float
    ks: float
    exponent: float
    degrees: float
    emission: float = 0.5

    def __str__(self) -> str:
        return f"kd {self.kd:g}, ks {self.ks:g}, n = {self.exponent:g}, {self.degrees:g} degrees"


@cache
def operators(slab: Slab) -> tuple[np.ndarray, np.ndarray]:
    """(diffuse, glossy), each (NODES + 1, NODES): from the radiance that arrives along the nodes' angles to what
    leaves along them and, in the last row, towards the camera."""
    nodes, weights = np.polynomial.legendre.leggauss(NODES)
    cos_i, weights = (nodes + 1) / 2, weights / 2
    cos_o = np.append(cos_i, np.cos(np.radians(slab.degrees)))[:, None]
    across = np.sqrt((1 - cos_o**2) * (1 - cos_i**2))[..., None]
    turn = (np.arange(TURNS) + 0.5) / TURNS * np.pi
    to_mirror = np.maximum((cos_o * cos_i)[..., None] + across * np.cos(turn), 0)
    lobe = (slab.exponent + 2) / (2 * np.pi) * (to_mirror**slab.exponent).mean(axis=2)
    flux = 2 * np.pi * cos_i * weights
    return np.full(lobe.shape, slab.kd / np.pi) * flux, slab.ks * lobe * flux


@cache
def radiance(slab: Slab, total: int, diffuse: int, glossy: int) -> float:
    """What the camera sees with `max_bounces`, `diffuse_bounces` and `glossy_bounces`: the first reflection is none,
    and where a limit is passed a ray still finds what emits."""
    scatter, gloss = operators(slab)
    total, diffuse, glossy = (min(limit, ENDLESS) for limit in (total, diffuse, glossy))
    last = np.full(NODES + 1, slab.emission)
    further: list[np.ndarray] = []  # with one diffuse reflection more, by the number of glossy ones
    for d in range(min(diffuse, total), -1, -1):
        row = [last] * (min(glossy, total - d) + 2)
        for g in range(len(row) - 2, -1, -1):
            beyond = further[g] if g < len(further) else last
            row[g] = slab.emission + scatter @ beyond[:-1] + gloss @ row[g + 1][:-1]
        further = row
    return float(further[0][-1])


def scene(slab: Slab, size: int) -> Scene:
    made = Scene(width=size, height=size)
    angle = np.radians(slab.degrees)
    camera = scenes.camera(origin=(0, 0, 0.5), towards=(np.sin(angle), 0, -np.cos(angle)))
    made.camera = replace(camera, window=(-1e-6, 1e-6, -1e-6, 1e-6))
    colors = {"kd": (slab.kd,) * 3, "ks": (slab.ks,) * 3, "emission": (slab.emission,) * 3}
    made.materials = [Material("wall", exponent=slab.exponent, **colors)]
    # Off the centre, so that no ray of the camera meets a diagonal.
    side, aside = 2 * HALF, -1.1 * HALF
    made.add_instance(scenes.quad_mesh((-HALF, aside, 0), (side, 0, 0), (0, side, 0), "floor"))
    made.add_instance(scenes.quad_mesh((aside, -HALF, 1), (0, side, 0), (side, 0, 0), "ceiling"))
    return made
