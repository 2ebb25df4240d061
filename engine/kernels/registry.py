"""Everything that draws by a density, in one list: hemispheres, surfaces, lights, worlds, lenses, filters.

Nothing is rendered through it: the kernels branch on constants, so that what a scene lacks is not compiled. It is how
the checks of tests/statistics find what there is: each entry is drawn from a hundred thousand times and held against
its density. What settings name and what engine/scene.py has of lamps is found by itself; the tests tell which function
that takes random numbers, which class of lamp and which of its fields nobody has said anything about.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator
from dataclasses import Field, fields
from typing import Any, NamedTuple

import numpy as np

from ..scene import Aperture, AreaLight, Lamp, PointLight, SpotLight, SunLight, World
from ..settings import HEMISPHERE_SAMPLING, LOBE_SELECTION, PIXEL_FILTERS
from .bsdf import combined, diffuse, phong
from .camera import generate_ray, thin_lens
from .film import filter as pixel_filter
from .light import area, environment, point, spherical, sun
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


# --- lamps -----------------------------------------------------------------------------------------------------------

# What every field of a lamp is tried with, in all combinations; each `bool` is a switch and takes both of its values.
# Fields that all lamps share say who is lit, which no sampler knows.
LAMP_FIELDS: dict[str, tuple] = {
    "intensity": (LIGHT,),
    "radiance": (LIGHT,),
    "irradiance": (LIGHT,),
    "radius": (0.5,),
    "half_angle": (0.7,),
    "blend": (0.15,),
    "size_x": (1.5,),
    "size_y": (0.6,),
    "spread": (np.pi, 1.0),
    "angle": (0.01, 1.5),
}
_SHARED_FIELDS = {field.name for field in fields(Lamp)}

_SPHERE = (point.sample_sphere_lamp, spherical.sample_sphere, warp.uniform_cone, warp.cosine_hemisphere)
_DISK = (point.sample_disk_lamp, warp.uniform_cone, warp.concentric_disk)
_RECTANGLE = (area.sample_rectangle_lamp, spherical.sample_rectangle)
_ELLIPSE = (area.sample_ellipse_lamp, warp.concentric_disk)
_SUN = (sun.sample_sun, warp.uniform_cone)

# Family and draws of a lamp, by its class.
_LAMPS: dict[type[Lamp], Callable[[Any], tuple[str, tuple]]] = {
    PointLight: lambda lamp: ("lamp", _DISK if lamp.soft_falloff else _SPHERE),
    SpotLight: lambda lamp: ("lamp", _DISK if lamp.soft_falloff else _SPHERE),
    AreaLight: lambda lamp: ("lamp", _ELLIPSE if lamp.ellipse else _RECTANGLE),
    SunLight: lambda lamp: ("sun", _SUN),
}


def lamp_classes(base: type[Lamp] = Lamp) -> Iterator[type[Lamp]]:
    """All kinds of lamps that a scene may have."""
    for kind in base.__subclasses__():
        yield kind
        yield from lamp_classes(kind)


def lamp_fields(kind: type[Lamp]) -> Iterator[tuple[Field, tuple]]:
    """The fields of a lamp that are its own, and what each is tried with: nothing, where nobody has said."""
    for field in fields(kind):
        if field.name not in _SHARED_FIELDS:
            yield field, (False, True) if field.type in (bool, "bool") else LAMP_FIELDS.get(field.name, ())


def _lamp_samplers() -> Iterator[Sampler]:
    for kind in lamp_classes():
        choices = list(lamp_fields(kind))
        for values in itertools.product(*(tried for _, tried in choices)):
            chosen = {field.name: value for (field, _), value in zip(choices, values, strict=True)}
            # Its name has what tells it from the others: switches that are on, and numbers of which there are several.
            switched = (field for field, tried in choices if len(tried) > 1)
            parts = (f.name if chosen[f.name] is True else f"{f.name} {chosen[f.name]:.2g}" for f in switched
                     if chosen[f.name] is not False)  # fmt: skip
            name = " ".join([kind.__name__, *parts])
            lamp = kind(name, **chosen)
            family, draws = _LAMPS.get(kind, lambda lamp: (type(lamp).__name__, ()))(lamp)
            yield Sampler(family, name, lamp, draws)


# --- the list --------------------------------------------------------------------------------------------------------

_DIFFUSE = (diffuse.sample_diffuse, warp.concentric_disk, warp.cosine_hemisphere)
_DIFFUSE += (warp.uniform_hemisphere, warp.rejection_hemisphere)
_LENS = (generate_ray, thin_lens.through_lens)
_TRIANGLE = np.array([(-0.8, -0.5, 0), (0.9, -0.6, 0), (0, 0.7, 0.3)])
_QUAD = np.array([(-0.7, -0.4, 0), (0.7, -0.4, 0), (0.7, 0.4, 0), (-0.7, 0.4, 0)])


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
    *_lamp_samplers(),
    Sampler("emitter", "triangle", _TRIANGLE, (spherical.sample_triangle,)),
    Sampler("emitter", "rectangle", _QUAD, (spherical.sample_rectangle,)),
    Sampler("world", "smooth", World(LIGHT, _image(16, 32, "smooth")), (environment.sample_environment,)),
    Sampler("world", "hot pixel", World(LIGHT, _image(32, 64, "hot")), (environment.sample_environment,)),
    Sampler("world", "hot pixel in a sky", World(LIGHT, _image(32, 64, "sky")), (environment.sample_environment,)),
    *(
        Sampler("lens", f"{blades} blades", Aperture(0.5, 3.0, blades, 0.4), (*_LENS, warp_function))
        for blades, warp_function in ((0, warp.concentric_disk), (3, warp.regular_polygon), (6, warp.regular_polygon))
    ),
    *(Sampler("filter", name, name, (pixel_filter.sample_filter,)) for name in PIXEL_FILTERS),
)

# Functions with random numbers among their arguments, or with names as if, that no entry draws by; and why. What they
# call in their own file goes with them.
NO_DENSITY = {
    "light.emitters.sample_light": "chooses among the entries above; each is drawn through it",
    "light.point.sample_point": "a delta",
    "light.sun.choose_sun": "a choice: tests/kernels/test_light_groups.py holds its frequencies",
    "light.tree.sample_tree": "a choice: tests/kernels/test_light_tree.py holds its frequencies",
    "light.environment._mix_color": "u and v are places within a cell",
    "geom.surface._shading_normal": "u and v are barycentric coordinates",
    "geom.surface._off_the_edges": "u and v are barycentric coordinates",
    "geom.elementary.sin_cos_turn": "u is a part of a turn",
    "sampler.random.random_1d": "random numbers: tests/kernels/test_sampler.py",
    "sampler.sobol.sample_1d": "random numbers: tests/kernels/test_sampler.py",
    "sampler.sobol.sample_2d": "random numbers: tests/kernels/test_sampler.py",
    "vertex.scatter": "draws by the entries above, with the state that rejection sampling needs",
}
# Of what else is drawn from, the fields that the entries and their adapters vary, and those that no draw depends on.
OTHER_FIELDS = {
    "Aperture": {"radius", "focus_distance", "blades", "rotation", "ratio"},
    "Camera": {"transform", "window", "orthographic", "aperture", "clip_start", "clip_end"},
    "World": {"color", "image", "rotation", "visibility"},
}
