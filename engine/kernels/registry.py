"""Everything that draws by a density, in one list: hemispheres, surfaces, lights, worlds, lenses, filters.

Nothing is rendered through it: the kernels branch on constants, so that what a scene lacks is not compiled. It is how
the checks of tests/statistics find what there is: each entry is drawn from a hundred thousand times and held against
its density. A new lamp, world, lens or surface is one line here; a test tells which function has none.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from ..scene import Aperture, AreaLight, PointLight, SpotLight, SunLight, World
from ..settings import HEMISPHERE_SAMPLING, LOBE_SELECTION, PIXEL_FILTERS
from .bsdf import combined, diffuse, phong
from .camera import thin_lens
from .film import filter as pixel_filter
from .light import area, emitters, environment, point, spherical, sun
from .sampler import warp

LIGHT = (1.0, 0.9, 0.8)


class Sampler(NamedTuple):
    """One thing that draws.

    family   how it is drawn from and what its density is asked with: see the adapters of tests/statistics
    name     as settings and messages have it
    example  what the family makes a case from: the place in a setting, or a part of a scene (lamps about the origin,
             vertices of emissive surfaces (3 or 4, 3) in metres)
    draws    the functions that do the drawing, those that they call included
    """

    family: str
    name: str
    example: Any
    draws: tuple


_DIFFUSE = (diffuse.sample_diffuse, warp.concentric_disk, warp.cosine_hemisphere)
_DIFFUSE += (warp.uniform_hemisphere, warp.rejection_hemisphere)
_SPHERE = (point.sample_sphere_lamp, spherical.sample_sphere, warp.uniform_cone, warp.cosine_hemisphere)
_DISK = (point.sample_disk_lamp, warp.uniform_cone, warp.concentric_disk)
_RECTANGLE = (area.sample_rectangle_lamp, spherical.sample_rectangle)
_ELLIPSE = (area.sample_ellipse_lamp, warp.concentric_disk)


def _image(height: int, width: int, kind: str) -> np.ndarray:
    """(height, width, 3) float32: a smooth sky, or a single bright pixel before a dim one or a black one."""
    v, u = (np.arange(height) + 0.5)[:, None] / height, (np.arange(width) + 0.5)[None] / width
    sky = 0.3 + v * v + 0.2 * np.cos(2 * np.pi * u)
    if kind != "smooth":
        sky = np.full((height, width), 0.0 if kind == "hot" else 0.5)
        sky[height * 5 // 8, width // 6] = 1e4
    return (sky[:, :, None] * LIGHT).astype(np.float32)


SAMPLERS: tuple[Sampler, ...] = (
    *(Sampler("hemisphere", name, i, _DIFFUSE) for i, name in enumerate(HEMISPHERE_SAMPLING)),
    Sampler("phong", "phong", None, (phong.sample_phong, combined.sample)),
    *(Sampler("combined", name, i, (combined.sample,)) for i, name in enumerate(LOBE_SELECTION)),
    Sampler("lamp", "sphere", PointLight("sphere", intensity=LIGHT, radius=0.5), _SPHERE),
    Sampler("lamp", "disk", PointLight("disk", intensity=LIGHT, radius=0.5, soft_falloff=True), _DISK),
    Sampler("lamp", "spot sphere", SpotLight("spot", intensity=LIGHT, radius=0.5, half_angle=0.7), _SPHERE),
    Sampler("lamp", "spot disk", SpotLight("spot", intensity=LIGHT, radius=0.5, soft_falloff=True), _DISK),
    Sampler("lamp", "rectangle", AreaLight("area", radiance=LIGHT, size_x=1.5, size_y=0.6), _RECTANGLE),
    Sampler("lamp", "spread", AreaLight("spread", radiance=LIGHT, size_x=1.5, spread=1.0), _RECTANGLE),
    Sampler("lamp", "ellipse", AreaLight("ellipse", radiance=LIGHT, size_x=1.5, ellipse=True), _ELLIPSE),
    Sampler(
        "lamp",
        "spread ellipse",
        AreaLight("spread ellipse", radiance=LIGHT, size_x=1.5, size_y=0.6, ellipse=True, spread=0.6),
        _ELLIPSE,
    ),
    Sampler("sun", "sun", SunLight("sun", irradiance=LIGHT, angle=0.01), (sun.sample_sun, warp.uniform_cone)),
    Sampler("sun", "wide sun", SunLight("wide sun", irradiance=LIGHT, angle=1.5), (sun.sample_sun, warp.uniform_cone)),
    Sampler(
        "emitter", "triangle", np.array([(-0.8, -0.5, 0), (0.9, -0.6, 0), (0, 0.7, 0.3)]), (spherical.sample_triangle,)
    ),
    Sampler(
        "emitter",
        "rectangle",
        np.array([(-0.7, -0.4, 0), (0.7, -0.4, 0), (0.7, 0.4, 0), (-0.7, 0.4, 0)]),
        (spherical.sample_rectangle,),
    ),
    Sampler("world", "smooth", World(LIGHT, _image(16, 32, "smooth")), (environment.sample_environment,)),
    Sampler("world", "hot pixel", World(LIGHT, _image(32, 64, "hot")), (environment.sample_environment,)),
    Sampler("world", "hot pixel in a sky", World(LIGHT, _image(32, 64, "sky")), (environment.sample_environment,)),
    *(
        Sampler("lens", f"{blades} blades", Aperture(0.5, 3.0, blades, 0.4), (thin_lens.through_lens, warp_function))
        for blades, warp_function in ((0, warp.concentric_disk), (3, warp.regular_polygon), (6, warp.regular_polygon))
    ),
    *(Sampler("filter", name, name, (pixel_filter.sample_filter,)) for name in PIXEL_FILTERS),
)

# Functions that draw without a density of their own, and why.
NO_DENSITY = {
    emitters.sample_light: "chooses among the entries above; each is drawn through it",
    point.sample_point: "a delta",
}
