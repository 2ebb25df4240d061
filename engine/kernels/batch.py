"""The memory of a batch of paths, which stage after stage of the kernel works through: rows of numbers, a column for
each path. Rows are named like `tables.py` names words; a vector of the path's begins at its row and takes three.

A row is a little longer than the batch, so that the last lanes of a vector find room, and so that rows do not lie a
multiple of 4096 bytes apart, where the processor's cache would keep only a few of them.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from .embree import PACKET_ROWS, PACKET_WIDTH, aligned_memory, init_ray, ray_words
from .jit import device
from .records import RayMemory
from .simd import WIDTH, add_at, at, compress, load, put_at, store

BATCH = 1024
COLUMNS = BATCH + WIDTH


def _rows(*heights: int) -> tuple:
    """The first rows of things so many rows high, and how many that are together. See `tables.words`."""
    starts = np.cumsum((0, *heights))
    return (*(np.int64(row) for row in starts[:-1]), int(starts[-1]))


# Of a sample, by its place in the batch: pixel, number, what has arrived at the camera.
X, Y, INDEX, LIGHT, ALPHA, SAMPLE_ROWS = _rows(1, 1, 1, 3, 1)
# Of a live path: where its random numbers come from, its place in the batch, throughput, the ray (see `records.Ray`)
# and the `Stretch` of it that is yet to be followed.
KEY, ORDER, PLACE, THROUGHPUT, P, N, WI, PDF, START, T_NEAR, T_FAR, PATH_ROWS = _rows(1, 1, 1, 3, 3, 3, 3, 1, 3, 1, 1)
# Of its ray's hit: whether there is one, then `surface.Hit`.
MET, TRIANGLE, INSTANCE, U, V, HIT_ROWS = _rows(1, 1, 1, 1, 1)
# Of a shadow ray: the place of its path, the ray, the light that it brings.
TO, FROM, DIRECTION, END, BRINGS, SHADOW_ROWS = _rows(1, 3, 3, 1, 3)

_SIZES = (SAMPLE_ROWS * COLUMNS, PATH_ROWS * COLUMNS, HIT_ROWS * COLUMNS, SHADOW_ROWS * COLUMNS, PACKET_ROWS * WIDTH)
_ENDS = tuple(int(end) for end in np.cumsum(_SIZES))


class Batch(NamedTuple):
    """Arrays (rows, columns) of float32, and the same memory as uint32 under the name that ends in `_words`.

    packets  sixteen rays as Embree takes them, see `intersect_packets`;  ray: one, which has the rest of the memory
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
    ray: RayMemory


def new_batch(lamp_count: int) -> np.ndarray:
    """A thread's memory, in a scene where rays may meet so many lamps."""
    memory = aligned_memory(_ENDS[-1] + ray_words(lamp_count, WIDTH))
    init_ray(memory[_ENDS[-1] :], lamp_count)
    return memory


@device
def batch_of(memory):
    """The `Batch` in the memory of `new_batch`."""
    words = memory.view(np.uint32)
    a, b, c, d, e = _ENDS
    samples, sample_words = memory[0:a].reshape(SAMPLE_ROWS, COLUMNS), words[0:a].reshape(SAMPLE_ROWS, COLUMNS)
    paths, path_words = memory[a:b].reshape(PATH_ROWS, COLUMNS), words[a:b].reshape(PATH_ROWS, COLUMNS)
    hits, hit_words = memory[b:c].reshape(HIT_ROWS, COLUMNS), words[b:c].reshape(HIT_ROWS, COLUMNS)
    shadows, shadow_words = memory[c:d].reshape(SHADOW_ROWS, COLUMNS), words[c:d].reshape(SHADOW_ROWS, COLUMNS)
    parts = (WIDTH // PACKET_WIDTH, PACKET_ROWS, PACKET_WIDTH)
    packets, packet_words = memory[d:e].reshape(parts), words[d:e].reshape(parts)
    ray = RayMemory(memory[e:], words[e:])
    return Batch(
        samples, sample_words, paths, path_words, hits, hit_words, shadows, shadow_words, packets, packet_words, ray
    )


@device
def load_3(rows, row, i):
    return load(rows, row, i), load(rows, row + 1, i), load(rows, row + 2, i)


@device
def store_3(rows, row, i, v):
    store(rows, row, i, v[0])
    store(rows, row + 1, i, v[1])
    store(rows, row + 2, i, v[2])


@device
def pack(rows, row, i, value, mask):
    """Write the lanes of the mask side by side from column i on. What lies behind them is lost."""
    store(rows, row, i, compress(value, mask))


@device
def pack_3(rows, row, i, v, mask):
    pack(rows, row, i, v[0], mask)
    pack(rows, row + 1, i, v[1], mask)
    pack(rows, row + 2, i, v[2], mask)


@device
def at_3(rows, row, place):
    return at(rows, row, place), at(rows, row + 1, place), at(rows, row + 2, place)


@device
def add_at_3(rows, row, place, v, mask):
    add_at(rows, row, place, v[0], mask)
    add_at(rows, row + 1, place, v[1], mask)
    add_at(rows, row + 2, place, v[2], mask)


@device
def put_at_3(rows, row, place, v, mask):
    put_at(rows, (row, place), v[0], mask)
    put_at(rows, (row + 1, place), v[1], mask)
    put_at(rows, (row + 2, place), v[2], mask)
