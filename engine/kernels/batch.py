"""The memory of a batch of paths, which stage after stage of the kernel works through: rows of numbers, a column for
each path. `rows` names them.

A row is a little longer than the batch, so that the last lanes of a vector find room, and so that rows do not lie a
multiple of 4096 bytes apart, where the processor's cache would keep only a few of them.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from ..features import Features
from . import rows
from .embree import PACKET_ROWS, PACKET_WIDTH, aligned_memory, init_ray, ray_words
from .geom.vec import ZERO
from .jit import device
from .records import Bounces, Ray, RayMemory, Stretch
from .simd import WIDTH, add_at, at, load, put_at, store, store_front, uint32
from .tables import CAMERA_RAY, DIFFUSE_RAY

BATCH = 1024
COLUMNS = BATCH + WIDTH

_HEIGHTS = rows.SAMPLE_ROWS, rows.PATH_ROWS, rows.HIT_ROWS, rows.SHADOW_ROWS
_SHAPES = (*((height, COLUMNS) for height in _HEIGHTS), (WIDTH // PACKET_WIDTH, PACKET_ROWS, PACKET_WIDTH))
_ENDS = tuple(int(end) for end in np.cumsum([math.prod(shape) for shape in _SHAPES]))
PART_WORDS, LOOK_WORDS = rows.PART_ROWS * COLUMNS, rows.PATH_ROWS * COLUMNS


class Batch(NamedTuple):
    """Arrays (rows, columns) of float32, and the same memory as uint32 under the name that ends in `_words`.

    packets  sixteen rays as Embree takes them, see `intersect_packets`;  ray: one, which has the rest of the memory
    parts    of the samples' light, see `parts`; without columns where no pass shows them
    looks    as `paths`, of rays that see as shadow rays do (`Ray.as_shadow`); without columns where all see the same
    """

    samples: np.ndarray
    sample_words: np.ndarray
    paths: np.ndarray
    path_words: np.ndarray
    hits: np.ndarray
    hit_words: np.ndarray
    shadows: np.ndarray
    shadow_words: np.ndarray
    packets: np.ndarray
    packet_words: np.ndarray
    parts: np.ndarray
    looks: np.ndarray
    look_words: np.ndarray
    ray: RayMemory


def new_batch(f: Features, lamp_count: int = 0) -> np.ndarray:
    """A thread's memory, in a scene with these features where rays may meet so many lamps."""
    end = _ENDS[-1] + f.light_passes * PART_WORDS + (1 - f.shared_light) * LOOK_WORDS
    memory = aligned_memory(end + ray_words(lamp_count, WIDTH))
    init_ray(memory[end:], lamp_count)
    return memory


@device
def batch_of(f, memory):
    """The `Batch` in the memory of `new_batch`."""
    words = memory.view(np.uint32)
    a, b, c, d, e = _ENDS
    part_end = e + f.light_passes * PART_WORDS
    end = part_end + (1 - f.shared_light) * LOOK_WORDS
    of_looks = rows.PATH_ROWS, (1 - f.shared_light) * COLUMNS
    of_samples, of_paths, of_hits, of_shadows, of_packets = _SHAPES
    return Batch(
        memory[0:a].reshape(of_samples),
        words[0:a].reshape(of_samples),
        memory[a:b].reshape(of_paths),
        words[a:b].reshape(of_paths),
        memory[b:c].reshape(of_hits),
        words[b:c].reshape(of_hits),
        memory[c:d].reshape(of_shadows),
        words[c:d].reshape(of_shadows),
        memory[d:e].reshape(of_packets),
        words[d:e].reshape(of_packets),
        memory[e:part_end].reshape((rows.PART_ROWS, f.light_passes * COLUMNS)),
        memory[part_end:end].reshape(of_looks),
        words[part_end:end].reshape(of_looks),
        RayMemory(memory[end:], words[end:]),
    )


@device
def with_looks(batch):
    """The batch with the rays that see as shadow rays do in place of its paths."""
    return Batch(
        batch.samples,
        batch.sample_words,
        batch.looks,
        batch.look_words,
        batch.hits,
        batch.hit_words,
        batch.shadows,
        batch.shadow_words,
        batch.packets,
        batch.packet_words,
        batch.parts,
        batch.looks,
        batch.look_words,
        batch.ray,
    )


@device
def load_3(array, row, i):
    return load(array, row, i), load(array, row + 1, i), load(array, row + 2, i)


@device
def store_3(array, row, i, v):
    store(array, row, i, v[0])
    store(array, row + 1, i, v[1])
    store(array, row + 2, i, v[2])


@device
def store_front_3(array, row, i, v, mask):
    """Write the lanes of the mask side by side from column i on. What lies behind them is lost."""
    store_front(array, row, i, v[0], mask)
    store_front(array, row + 1, i, v[1], mask)
    store_front(array, row + 2, i, v[2], mask)


@device
def at_3(array, row, place):
    return at(array, row, place), at(array, row + 1, place), at(array, row + 2, place)


@device
def add_at_3(array, row, place, v, mask):
    add_at(array, row, place, v[0], mask)
    add_at(array, row + 1, place, v[1], mask)
    add_at(array, row + 2, place, v[2], mask)


@device
def put_at_3(array, row, place, v, mask):
    put_at(array, (row, place), v[0], mask)
    put_at(array, (row + 1, place), v[1], mask)
    put_at(array, (row + 2, place), v[2], mask)


@device
def is_mixed(f):
    """Whether the paths of one stage differ in how often they were scattered, or in the kinds of their rays."""
    return f.transparency or f.holdout or f.ray_kinds or not f.shared_light


@device
def bounces_at(f, batch, i, stage):
    """The `Bounces` of paths i.. in a stage."""
    total, diffuse, glossy = uint32(stage), np.uint32(0), np.uint32(0)
    if is_mixed(f):
        total = load(batch.path_words, rows.BOUNCES, i)
    if f.ray_kinds:
        diffuse = load(batch.path_words, rows.DIFFUSE, i)
        glossy = total - diffuse
    return Bounces(total, diffuse, glossy)


@device
def rays_at(f, batch, i, stage, as_shadow):
    """The `Ray` of paths i.. in a stage."""
    paths, kind = batch.paths, CAMERA_RAY if stage == 0 else DIFFUSE_RAY
    if is_mixed(f):
        kind = load(batch.path_words, rows.KIND, i)
    p, n, wi = load_3(paths, rows.P, i), load_3(paths, rows.N, i), load_3(paths, rows.WI, i)
    return Ray(p, n, wi, kind, load(paths, rows.PDF, i), as_shadow)


@device
def stretches_at(f, batch, i):
    """The `Stretch` of the rays of paths i.."""
    paths, begins = batch.paths, ZERO
    if is_mixed(f):
        begins = load(paths, rows.BEGINS, i)
    return Stretch(load_3(paths, rows.START, i), load(paths, rows.T_NEAR, i), load(paths, rows.T_FAR, i), begins)
