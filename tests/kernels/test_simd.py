"""Vectors calculate in each lane what numpy does, and functions that take scalars too give the same for both."""

from __future__ import annotations

import math

import numpy as np
import pytest

from engine.kernels.geom import elementary
from engine.kernels.geom.vec import ONE, ZERO
from engine.kernels.jit import kernel
from engine.kernels.simd import (
    WIDTH,
    add_at,
    any_of,
    at,
    compress,
    count,
    first_lanes,
    float32,
    float64,
    floor,
    int32,
    lanes,
    load,
    load_parts,
    no,
    put_at,
    row_at,
    select,
    store,
    store_parts,
    to_index,
    uint32,
)

N = 4 * WIDTH


@pytest.fixture
def numbers() -> np.ndarray:
    """(3, N) float32, about 0"""
    return np.random.default_rng(3).normal(0, 2, (3, N)).astype(np.float32)


@kernel
def arithmetic(x, out):
    for i in range(0, N, WIDTH):
        a, b = load(x, 0, i), load(x, 1, i)
        store(out, 0, i, (a + b) * np.float32(3) - a / b)
        store(out, 1, i, min(a, max(b, ZERO)) + math.sqrt(abs(a)))
        store(out, 2, i, -floor(a) + math.copysign(ONE, b))
        store(out, 3, i, select((a < b) | no(a <= ZERO) & (b != ZERO), a, ONE))
        store(out, 4, i, float32(int32(a)) + float32(float64(b) * 0.5))
        whole = uint32(int32(a * np.float32(1000)))
        store(out, 5, i, float32(int32((whole << np.uint32(3)) ^ (whole >> np.uint32(2)))))


def test_operators(numbers) -> None:
    out = np.zeros((6, N), np.float32)
    arithmetic(numbers, out)
    a, b = numbers[0], numbers[1]
    whole = (a * np.float32(1000)).astype(np.int32).view(np.uint32)
    expected = (
        (a + b) * 3 - a / b,
        np.minimum(a, np.maximum(b, 0)) + np.sqrt(np.abs(a)),
        -np.floor(a) + np.copysign(1, b),
        np.where((a < b) | (a > 0), a, 1),
        np.trunc(a) + b / 2,
        ((whole << 3) ^ (whole >> 2)).view(np.int32),
    )
    for ours, theirs in zip(out, expected, strict=True):
        assert np.allclose(ours, theirs, rtol=1e-5, atol=1e-6)


@kernel
def memory(table, rows, columns, out, sums, places):
    """out: looked up places; whole rows, added up; what is below 0 side by side. Returns how many are."""
    kept = 0
    for i in range(0, N, WIDTH):
        row, column = to_index(load(rows, 0, i)), to_index(load(columns, 0, i))
        found, words = at(table, row, column), row_at(table, row)
        store(out, 0, i, found)
        store(out, 1, i, words[0] + words[7] + words[15])
        store(out, 2, kept, compress(found, found < ZERO))
        kept += count(found < ZERO)
        add_at(sums, 0, to_index(load(places, 0, i)), found, found < ZERO)
        put_at(sums, (1, to_index(load(places, 0, i))), found, no(found < ZERO))
        store(out, 3, i, float32(lanes()))
        store(out, 4, i, select(first_lanes(N - 5 - i), ONE, ZERO))
    return kept


def test_lanes_look_up_and_write_places_of_their_own() -> None:
    generator = np.random.default_rng(4)
    table = generator.normal(size=(9, WIDTH)).astype(np.float32)
    rows, columns = (generator.integers(0, n, (1, N)).astype(np.uint32) for n in (9, WIDTH))
    places = generator.permutation(N).astype(np.uint32)[None]
    out, sums = np.zeros((5, N + WIDTH), np.float32), np.ones((2, N), np.float32)
    kept = memory(table, rows, columns, out, sums, places)
    found = table[rows[0], columns[0]]
    below = found < 0
    assert np.array_equal(out[0, :N], found)
    assert np.allclose(out[1, :N], table[rows[0]][:, [0, 7, 15]].sum(axis=1), atol=1e-6)
    assert kept == below.sum() and np.array_equal(out[2, :kept], found[below])
    added, put = np.ones(N, np.float32), np.ones(N, np.float32)
    added[places[0, below]] += found[below]
    put[places[0, ~below]] = found[~below]
    assert np.allclose(sums[0], added) and np.array_equal(sums[1], put)
    assert np.array_equal(out[3, :N], np.tile(np.arange(WIDTH), N // WIDTH))
    assert np.array_equal(out[4, :N], np.arange(N) < N - 5)


@kernel
def in_parts(x, narrow, narrower, out):
    for i in range(0, N, WIDTH):
        store_parts(narrow, 1, 8, load(x, 0, i))
        store_parts(narrower, 2, 4, load_parts(narrow, 1, 8))
        store(out, 0, i, load_parts(narrower, 2, 4))


def test_parts_of_a_vector_lie_in_arrays_of_their_own(numbers) -> None:
    narrow, narrower = np.zeros((2, 3, 8), np.float32), np.zeros((4, 3, 4), np.float32)
    out = np.zeros((1, N), np.float32)
    in_parts(numbers, narrow, narrower, out)
    last = numbers[0, -WIDTH:]
    assert np.array_equal(narrow[:, 1].ravel(), last) and np.array_equal(narrower[:, 2].ravel(), last)
    assert np.array_equal(out[0], numbers[0]) and not narrow[:, ::2].any()


@kernel
def anything(x, limit):
    found = 0
    for i in range(0, N, WIDTH):
        if any_of(load(x, 0, i) > limit):
            found += 1
    return found


def test_any_of(numbers) -> None:
    limits = np.sort(numbers[0])[[0, N // 2, -2, -1]]
    blocks = numbers[0].reshape(-1, WIDTH).max(axis=1)
    assert [anything(numbers, limit) for limit in limits] == [int((blocks > limit).sum()) for limit in limits]


@kernel
def functions(x, out):
    """Of scalars into the first rows, of vectors into those behind."""
    for i in range(x.shape[1]):
        u = x[0, i]
        out[0, i], out[1, i] = elementary.exp(-np.float32(80) * u), elementary.log(u)
        out[2, i], out[3, i] = elementary.sin_cos_turn(u)
        sine, cosine = elementary.sin_cos_double(np.float64(u) * 6.5)
        out[4, i], out[5, i] = sine, cosine
    for i in range(0, x.shape[1], WIDTH):
        v = load(x, 0, i)
        store(out, 6, i, elementary.exp(-np.float32(80) * v))
        store(out, 7, i, elementary.log(v))
        s, c = elementary.sin_cos_turn(v)
        store(out, 8, i, s)
        store(out, 9, i, c)
        sine, cosine = elementary.sin_cos_double(float64(v) * 6.5)
        store(out, 10, i, float32(sine))
        store(out, 11, i, float32(cosine))


def test_elementary_functions() -> None:
    x = np.random.default_rng(5).random((1, 1024), np.float32)
    x[0, :3] = 1e-30, 1.0, 0.5
    out = np.zeros((12, 1024), np.float32)
    functions(x, out)
    u = x[0].astype(np.float64)
    exact = np.exp((np.float32(-80) * x[0]).astype(float)), np.log(u), np.sin(2 * np.pi * u), np.cos(2 * np.pi * u)
    exact += np.sin(6.5 * u), np.cos(6.5 * u)
    for row, expected in enumerate(exact * 2):
        assert np.allclose(out[row], expected, rtol=5e-6 if row % 6 == 0 else 3e-7, atol=2e-7 if row % 6 > 1 else 0)


def test_exp_underflows_to_almost_nothing() -> None:
    x = np.full((1, WIDTH), 2.0, np.float32)
    out = np.zeros((12, WIDTH), np.float32)
    functions(x, out)
    assert 0 < out[0, 0] < 2e-38 and 0 < out[6, 0] < 2e-38
