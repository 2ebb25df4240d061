"""What the functions of a path hand each other: its limits and tables, and the records that it carries along.

Records are rebuilt, not changed. After inlining nothing is left of them but their fields in registers.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from .embree import is_finite
from .geom.vec import BLACK, ONE, ZERO, add, average, mul, scale
from .jit import device
from .simd import select, to_index, words_at
from .tables import MATERIAL_WORDS

WHITE = (ONE, ONE, ONE)
# Rays pass at most this many transparent surfaces in a row.
MAX_TRANSPARENT = 256

# Decisions of a path, as dimensions of the sampler: two for the camera, then these for each vertex.
PIXEL, LENS, FIRST_VERTEX = np.int64(0), np.int64(1), np.int64(2)
LIGHT_CHOICE, LIGHT_POINT, LOBE, DIRECTION, ROULETTE, PASS, KIND, VERTEX_DECISIONS = 0, 1, 2, 3, 4, 5, 6, 7


# What a kernel counts besides rays: samples that were not finite; points that rejection sampling drew, and for how
# many directions.
REJECTED, DRAWS, DIRECTIONS, COUNTERS = 0, 1, 2, 3


class Limits(NamedTuple):
    """Where paths end. clamp_*: of a single contribution's mean over the channels; 0: none."""

    max_bounces: np.int32
    diffuse_bounces: np.int32
    glossy_bounces: np.int32
    clamp_direct: np.float32
    clamp_indirect: np.float32


class Tables(NamedTuple):
    """Everything a path reads: see kernels/tables.py and the modules that build each table."""

    geometry: tuple
    lights: tuple
    environment: tuple
    tree: tuple
    camera: np.ndarray
    filter_table: np.ndarray
    sampler: np.ndarray


class RayMemory(NamedTuple):
    """The thread's memory in which Embree finds a ray and leaves its hit; kernels/embree.py names the words.

    floats, words  the same memory as float32 and as uint32
    """

    floats: np.ndarray
    words: np.ndarray


class Numbers(NamedTuple):
    """Where a path's random numbers come from.

    key, order  of the sample: see `start_sample`
    dimension   of the vertex's first decision
    """

    key: np.uint32
    order: np.uint32
    dimension: np.int64


class Ray(NamedTuple):
    """A direction that was drawn, and all that decides which light counts along it.

    p, n      where it was drawn, and the shading normal there
    wi        unit
    kind      CAMERA_RAY, DIFFUSE_RAY or GLOSSY_RAY
    pdf       of wi; -1 for camera rays, with which no light sample competes
    as_shadow constant: it meets the surfaces that shadow rays meet, see kernels/mis.py
    """

    p: tuple
    n: tuple
    wi: tuple
    kind: np.uint32
    pdf: np.float32
    as_shadow: bool


class Stretch(NamedTuple):
    """The part of a ray that is yet to be followed.

    t_near, t_far  metres from `start`
    begins         how far from `Ray.p` the surface is that the ray has gone through, metres; 0: none
    """

    start: tuple
    t_near: np.float32
    t_far: np.float32
    begins: np.float32


class Light(NamedTuple):
    """What a path has gathered.

    radiance    so far
    throughput  how much of the radiance that is found next arrives at the camera
    limit       what a single contribution is clamped to; 0: nothing
    """

    radiance: tuple
    throughput: tuple
    limit: np.float32


class Vertex(NamedTuple):
    """A point where a path is scattered.

    p, n, ng  position, shading and geometric normal, both on wo's side as the mesh has them to each other. ng is as
              long as the step off the surface, see geom/surface.py
    start     where rays that leave p begin
    wo        unit, back along the path
    surface   (kd, ks, exponent, probability of drawing the Phong lobe)
    own       the emitter that p lies on, or -1
    """

    p: tuple
    n: tuple
    ng: tuple
    start: tuple
    wo: tuple
    surface: tuple
    own: np.int32


class Bounces(NamedTuple):
    """Scatterings so far. Kinds are counted only where `Features.ray_kinds` tells them apart."""

    total: np.uint32
    diffuse: np.uint32
    glossy: np.uint32


@device
def gather(f, light, found):
    """`light` after the path has found this radiance. A clamped contribution keeps its hue."""
    contribution = clamped(f, mul(light.throughput, found), light.limit)
    return Light(add(light.radiance, contribution), light.throughput, light.limit)


@device
def clamped(f, contribution, limit):
    """A contribution of no more than the limit in the mean over the channels; 0: no limit."""
    if f.clamp:
        mean = average(contribution)
        contribution = scale(contribution, select((limit > ZERO) & (mean > limit), limit / mean, ONE))
    return contribution


@device
def without_density(pdf):
    """The light of a direction that has no density: none. Where the density is no number neither is the light, so that
    the film counts the sample."""
    return select(is_finite(pdf), BLACK, (pdf, pdf, pdf))


@device
def material_color(geometry, material, word):
    first = to_index(material) * np.uint32(MATERIAL_WORDS) + np.uint32(word)
    red, green, blue, _ = words_at(geometry.materials, first, 4)
    return red, green, blue
