"""Vectors calculate in each lane what numpy does, and functions that take scalars too give the same for both."""

from __future__ import annotations

import ast
import math

import numba
import numpy as np
import pytest
from numba.core.errors import TypingError

from engine.kernels.geom import elementary
from engine.kernels.geom.vec import ONE, ZERO
from engine.kernels.jit import kernel
from engine.kernels.light.tree import NODE_WORDS
from engine.kernels.simd import (
    WIDTH,
    add_at,
    any_of,
    at,
    bits_of,
    count,
    first_lanes,
    float32,
    float64,
    float_of,
    floor,
    int32,
    lanes,
    load,
    load_parts,
    no,
    put_at,
    select,
    spread,
    store,
    store_front,
    store_parts,
    to_index,
    uint32,
    words_at,
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
def smaller_and_larger(x, out):
    """Of scalars into the first rows, of vectors into those behind."""
    for i in range(x.shape[1]):
        out[0, i], out[1, i] = min(x[0, i], x[1, i]), max(x[0, i], x[1, i])
    for i in range(0, x.shape[1], WIDTH):
        a, b = load(x, 0, i), load(x, 1, i)
        store(out, 2, i, min(a, b))
        store(out, 3, i, max(a, b))


def test_min_and_max_are_those_of_scalars_to_the_bit() -> None:
    some = np.array([np.nan, -np.inf, -1, -0.0, 0.0, 1, np.inf, 2], np.float32)
    x = np.stack([np.repeat(some, len(some)), np.tile(some, len(some))])
    out = np.zeros((4, x.shape[1]), np.float32)
    smaller_and_larger(x, out)
    ordinary = np.isfinite(x).all(axis=0)
    assert np.array_equal(out[0, ordinary], x.min(axis=0)[ordinary])
    assert np.array_equal(out[:2].view(np.uint32), out[2:].view(np.uint32))


@kernel
def whole_numbers(words, out):
    for i in range(0, words.shape[1], WIDTH):
        a, b = load(words, 0, i), load(words, 1, i)
        store(out, 0, i, select(a < b, np.uint32(1), np.uint32(0)))
        store(out, 1, i, uint32(select(int32(a) < int32(b), np.int32(1), np.int32(0))))
        store(out, 2, i, uint32(int32(a) >> np.int32(3)))
        store(out, 3, i, a >> np.uint32(3))
        store(out, 4, i, uint32(bits_of(float_of(a) * np.float32(2))))
        store(out, 5, i, uint32(min(int32(a), int32(b))) ^ max(a, b))


def test_signed_and_unsigned_numbers() -> None:
    words = np.random.default_rng(6).integers(0, 1 << 32, (2, N), np.uint32)
    words[0, :4] = 0x80000000, 0x7FFFFFFF, 0xFFFFFFFF, 0x3F800000
    words[1, :4] = 0x7FFFFFFF, 0x80000000, 0x00000000, 0x3F800000
    out = np.zeros((6, N), np.uint32)
    whole_numbers(words, out)
    (a, b), (c, d) = words, words.view(np.int32)
    assert np.array_equal(out[0], a < b) and np.array_equal(out[1], c < d)
    assert np.array_equal(out[2].view(np.int32), c >> 3) and np.array_equal(out[3], a >> 3)
    assert np.array_equal(out[5], np.minimum(c, d).view(np.uint32) ^ np.maximum(a, b))
    with np.errstate(all="ignore"):
        twice = a.view(np.float32) * np.float32(2)
    ordinary = np.isfinite(twice) & (np.abs(twice) > 1e-37)
    assert np.array_equal(out[4][ordinary], twice.view(np.uint32)[ordinary]) and ordinary.sum() > N / 2


@kernel
def scalar_first(x, out):
    for i in range(0, N, WIDTH):
        a, word = load(x, 0, i), uint32(int32(abs(load(x, 1, i)) * np.float32(9)))
        store(out, 0, i, np.float32(3) - a)
        store(out, 1, i, ONE / a)
        store(out, 2, i, select(ONE < a, np.float32(2), a))  # noqa: SIM300
        store(out, 3, i, min(ONE, a) + max(ZERO, a))
        store(out, 4, i, float32(int32(np.uint32(4096) >> word)))
        store(out, 5, i, 2 * a - 1)


def test_a_scalar_may_stand_first(numbers) -> None:
    out = np.zeros((6, N), np.float32)
    scalar_first(numbers, out)
    a, word = numbers[0], (np.abs(numbers[1]) * np.float32(9)).astype(np.uint32)
    expected = (
        3 - a,
        1 / a,
        np.where(a > 1, 2, a),
        np.minimum(1, a) + np.maximum(0, a),
        np.uint32(4096) >> np.minimum(word, 31),
        2 * a - 1,
    )
    defined = word < 32
    for row, (ours, theirs) in enumerate(zip(out, expected, strict=True)):
        assert np.allclose(ours[defined], theirs[defined], rtol=1e-6), row


@kernel
def chosen(x, out):
    for i in range(0, N, WIDTH):
        a, b = load(x, 0, i), load(x, 1, i)
        (first, second), third = select(a < b, ((a, ONE), b), ((ZERO, b), b + ONE))
        store(out, 0, i, first)
        store(out, 1, i, second)
        store(out, 2, i, third)
        store(out, 3, i, select((a < ZERO) == (b < ZERO), select(a != b, ONE, b), ZERO))


def test_tuples_in_tuples_are_chosen_lane_by_lane(numbers) -> None:
    out = np.zeros((4, N), np.float32)
    chosen(numbers, out)
    a, b = numbers[:2]
    expected = np.where(a < b, a, 0), np.where(a < b, 1, b), np.where(a < b, b, b + 1), (a < 0) == (b < 0)
    assert np.array_equal(out, np.stack(expected).astype(np.float32))


@kernel
def memory(table, rows, columns, out, sums, places):
    """out: looked up places; whole rows and parts of them, added up; what is below 0 side by side.

    Returns how many are."""
    kept = 0
    for i in range(0, N, WIDTH):
        row, column = to_index(load(rows, 0, i)), to_index(load(columns, 0, i))
        found, words = at(table, row, column), words_at(table, row * np.uint32(WIDTH), 16)
        few = words_at(table, row * np.uint32(WIDTH) + np.uint32(3), 8)
        store(out, 0, i, found)
        store(out, 1, i, words[0] + words[7] + words[15] - few[0] - few[7])
        store_front(out, 2, kept, found, found < ZERO)
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
    assert np.allclose(out[1, :N], table[rows[0]][:, [0, 7, 15, 3, 10]] @ [1, 1, 1, -1, -1], atol=1e-6)
    assert kept == below.sum() and np.array_equal(out[2, :kept], found[below])
    added, put = np.ones(N, np.float32), np.ones(N, np.float32)
    added[places[0, below]] += found[below]
    put[places[0, ~below]] = found[~below]
    assert np.allclose(sums[0], added) and np.array_equal(sums[1], put)
    assert np.array_equal(out[3, :N], np.tile(np.arange(WIDTH), N // WIDTH))
    assert np.array_equal(out[4, :N], np.arange(N) < N - 5)


def reader_of_words(number: int):
    """A kernel that writes down `number` words from each place on: by lanes, then, behind these, one by one."""

    @kernel
    def read(table, places, out):
        for i in range(0, N, WIDTH):
            words = words_at(table, load(places, 0, i), number)
            for word in range(number):
                store(out, word, i, words[word])
        for i in range(N):
            words = words_at(table, places[0, i], number)
            for word in range(number):
                out[number + word, i] = words[word]

    return read


@pytest.mark.parametrize("dtype", [np.float32, np.int32, np.uint32])
@pytest.mark.parametrize("number", [1, 2, 4, 8, 16, 32])
def test_words_side_by_side(number, dtype) -> None:
    """Wherever they begin, and to the last of the table."""
    generator = np.random.default_rng(number)
    table = generator.integers(0, 1 << 20, 3 * number + 7).astype(dtype)
    places = generator.integers(0, len(table) - number + 1, (1, N)).astype(np.uint32)
    places[0, :2] = 0, len(table) - number
    out = np.zeros((2 * number, N), dtype)
    reader_of_words(number)(table, places, out)
    expected = table[places[0] + np.arange(number)[:, None]]
    assert np.array_equal(out[:number], expected) and np.array_equal(out[number:], expected)


def test_those_are_the_numbers_of_words_that_the_kernels_read(repository) -> None:
    """A new one has to be tested, too."""
    found = set()
    for path in (repository / "engine" / "kernels").rglob("*.py"):
        for call in ast.walk(ast.parse(path.read_text())):
            if isinstance(call, ast.Call) and getattr(call.func, "id", "") == "words_at":
                number = call.args[2]
                found.add(number.value if isinstance(number, ast.Constant) else {"NODE_WORDS": NODE_WORDS}[number.id])
    assert {2, 4, 8, 16} <= found <= {1, 2, 4, 8, 16, 32}


@kernel
def odd_tables(bytes_, cube, strided, index, out):
    for i in range(0, N, WIDTH):
        k = load(index, 0, i)
        store(out, 0, i, float32(int32(at(bytes_, k))))
        store(out, 1, i, at(cube, k & np.uint32(3), 2, k >> np.uint32(3)))
        store(out, 2, i, at(strided, k & np.uint32(3), k >> np.uint32(3)))
        store(out, 3, i, at(strided, 3, k >> np.uint32(3)))


def test_tables_of_bytes_of_three_dimensions_and_with_gaps() -> None:
    generator = np.random.default_rng(7)
    k = generator.integers(0, 64, (1, N)).astype(np.uint32)
    bytes_, cube = generator.integers(0, 256, 64).astype(np.uint8), generator.random((4, 5, 8), np.float32)
    strided = generator.random((8, 20), np.float32)[::2, 3:19:2]
    out = np.zeros((4, N), np.float32)
    odd_tables(bytes_, cube, strided, k, out)
    low, high = k[0] & 3, k[0] >> 3
    expected = bytes_[k[0]], cube[low, 2, high], strided[low, high], strided[3, high]
    assert np.array_equal(out, np.stack(expected).astype(np.float32)) and bytes_.max() > 127


@kernel
def wild(sums, words, places, mask, out):
    value = load(out, 0, 0)
    put_at(sums, (1, load(places, 0, 0)), value, load(mask, 0, 0) != np.uint32(0))
    add_at(sums, 2, load(places, 0, 0), value, load(mask, 0, 0) != np.uint32(0))
    put_at(words, load(places, 0, 0), np.uint32(7), load(mask, 0, 0) != np.uint32(0))


def test_lanes_that_write_nothing_may_point_anywhere() -> None:
    """Far outside of the process's memory, so that a touch ends it, and at a place that another lane writes."""
    sums, words, mask = np.ones((4, WIDTH), np.float32), np.ones(WIDTH, np.uint32), np.zeros((1, WIDTH), np.uint32)
    places = np.full((1, WIDTH), 0x7FFFFFFF, np.uint32)
    places[0, ::3], places[0, 1::3] = 0x80000000, 5
    mask[0, [4, 7]], places[0, [4, 7]] = 1, (5, 11)
    out = np.arange(WIDTH, dtype=np.float32)[None]
    wild(sums, words, places, mask, out)
    expected = np.ones((4, WIDTH), np.float32)
    expected[1, [5, 11]], expected[2, [5, 11]] = (4, 7), (5, 8)
    assert np.array_equal(sums, expected) and np.array_equal(np.flatnonzero(words == 7), [5, 11])


@kernel
def moved(x, limit, out):
    for i in range(0, N, WIDTH):
        a = load(x, 0, i)
        store_front(out, 0, i, a, a > limit)
        if any_of(a > limit):
            store(out, 1, i, spread(a, a > limit))


@pytest.mark.parametrize("limit", [-9, 0, 2])
def test_store_front_and_spread_the_first_lane(numbers, limit) -> None:
    out = np.zeros((2, N), np.float32)
    moved(numbers, np.float32(limit), out)
    for block in range(0, N, WIDTH):
        a, ours = numbers[0, block : block + WIDTH], out[:, block : block + WIDTH]
        kept = a[a > limit]
        assert np.array_equal(ours[0, : len(kept)], kept)
        if len(kept):
            assert np.array_equal(ours[1], np.where(a > limit, a, kept[0]))


@kernel
def fronts(masks, out):
    """Numbers of lanes, by each row of masks."""
    for row in range(masks.shape[0]):
        store_front(out, row, 1, lanes() + np.uint32(1), load(masks, row, 0) != np.uint32(0))


def test_store_front_by_every_mask() -> None:
    """And writes no more than a vector."""
    bits = np.arange(1 << WIDTH, dtype=np.uint32)[:, None] >> np.arange(WIDTH, dtype=np.uint32) & 1
    out, expected = np.full((1 << WIDTH, WIDTH + 2), 99, np.uint32), np.zeros((1 << WIDTH, WIDTH), np.uint32)
    fronts(np.ascontiguousarray(bits), out)
    number = bits.sum(axis=1, dtype=np.int64)
    row, lane = np.nonzero(bits)  # row by row, lanes ascending
    expected[row, np.arange(len(row)) - np.repeat(np.cumsum(number) - number, number)] = lane + 1
    front = np.arange(WIDTH) < number[:, None]
    assert np.array_equal(np.where(front, out[:, 1:-1], 0), expected)
    assert np.all(out[:, [0, -1]] == 99)


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


FLOATS, WORDS, BYTES = (np.zeros((1, 64), kind) for kind in (np.float32, np.uint32, np.uint8))
REFUSED = {
    "more digits": (lambda x, w, b: store(x, 0, 0, load(x, 0, 0) * 0.5), "cast one"),
    "kinds mixed": (lambda x, w, b: store(x, 0, 0, load(x, 0, 0) * load(w, 0, 0)), "cast one"),
    "masks in order": (lambda x, w, b: any_of((load(x, 0, 0) > ZERO) < (load(x, 0, 0) > ONE)), "means nothing"),
    "bits of floats": (lambda x, w, b: store(x, 0, 0, load(x, 0, 0) & load(x, 0, 0)), "means nothing"),
    "select int64": (lambda x, w, b: store(x, 0, 0, select(load(x, 0, 0) > ZERO, 1, 0)), "select between"),
    "select kinds": (lambda x, w, b: store(x, 0, 0, select(load(x, 0, 0) > ZERO, ONE, np.uint32(0))), "select between"),
    "select vectors": (lambda x, w, b: store(x, 0, 0, select(load(x, 0, 0) > ZERO, load(w, 0, 0), ONE)), "select betw"),
    "float as word": (lambda x, w, b: store(w, 0, 0, load(x, 0, 0)), "not stored"),
    "scalar as word": (lambda x, w, b: store(w, 0, 0, ONE), "not stored"),
    "float put": (lambda x, w, b: put_at(w, (0, lanes()), load(x, 0, 0), load(x, 0, 0) > ZERO), "not stored"),
    "word added": (lambda x, w, b: add_at(x, 0, lanes(), load(w, 0, 0), load(x, 0, 0) > ZERO), "not stored"),
    "added to words": (lambda x, w, b: add_at(w, 0, lanes(), ONE, load(x, 0, 0) > ZERO), "not stored"),
    "bytes side by side": (lambda x, w, b: store(w, 0, 0, load(b, 0, 0)), "vectors are of"),
    "into bytes": (lambda x, w, b: store(b, 0, 0, load(w, 0, 0)), "vectors are of"),
    "with gaps": (lambda x, w, b: store(x, 0, 0, load(x[:, ::2], 0, 0)), "C array"),
}


@pytest.mark.parametrize("name", REFUSED)
def test_what_makes_no_sense_is_refused(name) -> None:
    function, problem = REFUSED[name]
    with pytest.raises(TypingError, match=problem):
        numba.njit(function)(FLOATS, WORDS, BYTES)
