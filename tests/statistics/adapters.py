"""From the entries of engine/kernels/registry.py to cases of the chi-squared test: one thin adapter for each family.

An adapter says how the family is drawn from and how its density is asked, and from where: positions, angles, mixtures.
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Iterator
from dataclasses import replace

import numpy as np

from engine import Scene
from engine.kernels.registry import SAMPLERS, Sampler
from engine.reference.lights import make_lamp
from engine.scene import Aperture, AreaLight, PointLight, SpotLight, SunLight, World
from tests.statistics import chi2
from tests.statistics.drawn import UP, Crossed, Scaled
from tests.statistics.film import Filter, Lens, filters, lenses
from tests.statistics.lights import (
    SUNS,
    Light,
    emitter_case,
    emitters,
    everywhere,
    lamp_case,
    lamps,
    suns,
    world_case,
    worlds,
)
from tests.statistics.surfaces import COSINE, UNIFORM, Hemisphere, Surface, combined, hemispheres, phong_lobes

__all__ = ["ADAPTERS", "Crossed", "Scaled", "broken", "cases", "fine_twins"]

ADAPTERS: dict[str, Callable[[Sampler], Iterator[chi2.Case]]] = {
    "hemisphere": hemispheres,
    "phong": phong_lobes,
    "combined": combined,
    "lamp": lamps,
    "sun": suns,
    "emitter": emitters,
    "world": worlds,
    "lens": lenses,
    "filter": filters,
}


@functools.cache
def cases() -> dict[str, chi2.Case]:
    """Every case of every entry, by a name that no other has."""
    made: dict[str, chi2.Case] = {}
    for entry in SAMPLERS:
        for case in ADAPTERS[entry.family](entry):
            assert case.name not in made, f"two cases are called {case.name!r}"
            made[case.name] = case
    return made


def _lamp(lamp) -> chi2.Case:
    return lamp_case("broken", lamp, make_lamp(lamp, 1.0), (0.1, 0.2, -1.5), UP)


def _world(column: int) -> chi2.Case:
    image = np.full((16, 32, 3), 0.5, np.float32)
    image[9, column] = 100
    return world_case("broken", World((1.0, 1.0, 1.0), image))


def _sun(angle: float) -> chi2.Case:
    return Light("broken", SUNS, Scene(lights=[SunLight("s", irradiance=(1.0,) * 3, angle=angle)]), UP, UP, everywhere)


QUAD = np.array([(-0.7, -0.4, 0), (0.7, -0.4, 0), (0.7, 0.4, 0), (-0.7, 0.4, 0)])


def broken() -> dict[str, Crossed]:
    """A sampler of each family that is a little wrong: its draws come from other parameters than its density."""
    p = (0.1, 0.2, -0.8)
    sphere = PointLight("sphere", intensity=(1.0,) * 3, radius=0.5)
    spread = AreaLight("spread", radiance=(1.0,) * 3, size_x=2.0, size_y=2.0, spread=1.0)
    lens = Aperture(0.5, 3.0, 6, 0.4)
    return {
        "hemisphere": Crossed(Hemisphere(UNIFORM), Hemisphere(COSINE)),
        "phong": Crossed(Surface(ks=0.9, exponent=100, angle=45), Surface(ks=0.9, exponent=105, angle=45)),
        "combined": Crossed(Surface(0.4, 0.4, 30, 0.5, 60), Surface(0.4, 0.4, 30, 0.55, 60)),
        "lamp": Crossed(_lamp(sphere), _lamp(replace(sphere, radius=0.51))),
        "lamp, spread": Crossed(_lamp(spread), _lamp(replace(spread, spread=1.1))),
        "lamp, spot": Crossed(
            _lamp(SpotLight("s", intensity=(1.0,) * 3, radius=0.5, soft_falloff=True)), _lamp(sphere)
        ),
        "sun": Crossed(_sun(0.5), _sun(0.51)),
        "emitter": Crossed(emitter_case("broken", QUAD, p, UP), emitter_case("broken", QUAD * 1.02, p, UP)),
        "world": Crossed(_world(5), _world(6)),
        "lens": Crossed(Lens(lens), Lens(replace(lens, blades=7))),
        "filter": Crossed(Filter("BLACKMAN_HARRIS", 1.5), Filter("BLACKMAN_HARRIS", 1.55)),
    }


def fine_twins() -> dict[str, Crossed]:
    """As `broken`, by one per cent."""
    return {
        "exponent 100 for 101": Crossed(
            Surface(ks=0.9, exponent=100, angle=45), Surface(ks=0.9, exponent=101, angle=45)
        ),
        "lobe share 0.5 for 0.505": Crossed(Surface(0.4, 0.4, 30, 0.5, 60), Surface(0.4, 0.4, 30, 0.505, 60)),
        "filter 1.5 for 1.515": Crossed(Filter("BLACKMAN_HARRIS", 1.5), Filter("BLACKMAN_HARRIS", 1.515)),
    }
