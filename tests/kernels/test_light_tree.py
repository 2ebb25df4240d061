"""The light tree: one probability for walking down and for asking back, never 0 where light arrives, and less noise
than a choice by power."""

from __future__ import annotations

import numpy as np
import pytest
from light_checks import assert_float32, assert_frequencies, from_python, vec

from engine.kernels.jit import kernel
from engine.kernels.light import tree as words
from engine.kernels.light.tree import sample_tree, tree_probability
from engine.lighttree import build_light_tree

ONE_SIDED, TWO_SIDED, ALL_WAYS, SPOT = range(4)
SPOT_ANGLE = 0.4

call_sample_tree = from_python(sample_tree)
call_tree_probability = from_python(tree_probability)


@kernel
def draw(tree, p, n, u, emitters, rest, probabilities):
    for i in range(len(u)):
        emitters[i], probabilities[i], rest[i] = sample_tree(tree, p, n, u[i])


@kernel
def all_probabilities(tree, p, n, out):
    for i in range(len(out)):
        out[i] = tree_probability(tree, i, p, n)


def make_emitters(count: int, kinds=(ONE_SIDED, TWO_SIDED, ALL_WAYS, SPOT), seed: int = 1, size: float = 0.3):
    """Squares, spheres and spots in a cube of 4 m: (centers, axes, sizes, kinds, power)."""
    random = np.random.default_rng(seed)
    axes = random.normal(size=(count, 3))
    axes /= np.linalg.norm(axes, axis=1, keepdims=True)
    kind = random.choice(kinds, count)
    sizes = np.where(kind == SPOT, 0, size * random.random(count))
    return random.random((count, 3)) * 4, axes, sizes, kind, np.exp(random.normal(size=count))


def square(axis: np.ndarray, size: float) -> tuple[np.ndarray, np.ndarray]:
    """Half edges of the square with this normal."""
    x = np.cross(axis, [0, 1, 0] if abs(axis[1]) < 0.9 else [1, 0, 0])
    x *= size / np.linalg.norm(x)
    return x, np.cross(axis, x)


def build(emitters):
    centers, axes, sizes, kind, power = emitters
    bounds = np.zeros((len(centers), 6))
    for i, center in enumerate(centers):
        if kind[i] in (ONE_SIDED, TWO_SIDED):
            x, y = square(axes[i], sizes[i])
            reach = abs(x) + abs(y)
        else:
            reach = sizes[i]
        bounds[i, :3], bounds[i, 3:] = center - reach, center + reach
    theta_o = np.where(kind == ALL_WAYS, np.pi, 0)
    theta_e = np.where(kind == SPOT, SPOT_ANGLE, np.pi / 2)
    arrays = (a.astype(np.float32) for a in (bounds, axes, theta_o, theta_e, power))
    return build_light_tree(*arrays, two_sided=kind == TWO_SIDED)


def points_on(emitters, i: int, count: int, random) -> tuple[np.ndarray, np.ndarray]:
    """Points of emitter i and the normals there (for a sphere; elsewhere its axis)."""
    centers, axes, sizes, kind, _ = emitters
    if kind[i] in (ONE_SIDED, TWO_SIDED):
        x, y = square(axes[i], sizes[i])
        a, b = random.uniform(-1, 1, (2, count, 1))
        return centers[i] + a * x + b * y, np.broadcast_to(axes[i], (count, 3))
    if kind[i] == SPOT:
        return np.repeat(centers[i : i + 1], count, axis=0), np.broadcast_to(axes[i], (count, 3))
    d = random.normal(size=(count, 3))
    d /= np.linalg.norm(d, axis=1, keepdims=True)
    return centers[i] + sizes[i] * d, d


def contributions(emitters, i: int, p: np.ndarray, n: np.ndarray, random, count: int = 32) -> np.ndarray:
    """What points of emitter i send to p, relative to what they could send at most from there."""
    points, normals = points_on(emitters, i, count, random)
    to = points - p
    wi = to / np.maximum(np.linalg.norm(to, axis=1, keepdims=True), 1e-9)
    cosine = -np.sum(wi * normals, axis=1)
    kind = emitters[3][i]
    if kind == TWO_SIDED:
        emitted = abs(cosine)
    elif kind == SPOT:
        emitted = np.maximum(cosine - np.cos(SPOT_ANGLE), 0)
    else:
        emitted = np.maximum(cosine, 0)
    return emitted * np.maximum(wi @ n, 0)


def receivers(count: int, seed: int = 3):
    """(point, normal) pairs: inside the cube, around it, and on an emitter's level."""
    random = np.random.default_rng(seed)
    for i in range(count):
        p = random.random(3) * 4 if i % 2 else random.normal(size=3) * 6 + 2
        n = random.normal(size=3)
        n = np.eye(3)[i % 3] * random.choice([-1, 1]) if i % 5 == 0 else n / np.linalg.norm(n)
        yield p.astype(np.float32), n.astype(np.float32)


def probabilities(tree, p, n) -> np.ndarray:
    out = np.zeros(len(tree.paths), np.float32)
    all_probabilities(tree, vec(p), vec(n), out)
    return out.astype(np.float64)


DRAWS = 200_000


def assert_draws(tree, p, n, u: np.ndarray, told) -> None:
    """Walks down `tree` choose emitters as often as the tree `told` says."""
    chosen, rest, probability = np.zeros(DRAWS, np.int32), np.zeros(DRAWS, np.float32), np.zeros(DRAWS, np.float32)
    draw(tree, vec(p), vec(n), u, chosen, rest, probability)
    expected = probabilities(told, p, n)
    found = probability > 0
    assert np.allclose(probability[found], expected[chosen[found]], rtol=1e-4)
    counts = np.append(np.bincount(chosen[found], minlength=len(expected)), np.sum(~found))
    nothing = max(1 - expected.sum(), 0)
    assert_frequencies(counts, np.append(expected, nothing if nothing > 1e-5 else 0) * DRAWS, 30)
    assert np.all((rest[found] >= 0) & (rest[found] < 1))
    if found.sum() > 1000:
        common = found & (chosen == np.argmax(counts[:-1]))
        cells = np.bincount((rest[common] * 16).astype(int), minlength=16)
        assert_frequencies(cells, np.full(16, common.sum() / 16), 30)


@pytest.mark.parametrize("count", [1, 2, 3, 7, 60])
def test_frequencies_match_probabilities(count):
    tree = build(make_emitters(count))
    u = np.random.default_rng(5).random(DRAWS).astype(np.float32)
    for p, n in receivers(6):
        assert_draws(tree, p, n, u, tree)


def test_wrong_probabilities_and_uneven_numbers_are_caught():
    """One emitter of 60 that is told 5 % brighter; and random numbers that leave out a hundredth."""
    emitters = make_emitters(60, (ALL_WAYS,))
    tree, brighter = build(emitters), (*emitters[:4], emitters[4] * np.where(np.arange(60) == 7, 1.05, 1))
    u = np.random.default_rng(5).random(DRAWS).astype(np.float32)
    p, n = np.float32([2, 2, -1]), np.float32([0, 0, 1])
    assert_draws(tree, p, n, u, tree)
    for numbers, told in ((u, build(brighter)), (u * np.float32(0.99), tree)):
        with pytest.raises(AssertionError):
            assert_draws(tree, p, n, numbers, told)


def test_probabilities_sum_to_one_where_every_cluster_has_a_reachable_emitter():
    for kinds in ((ALL_WAYS,), (TWO_SIDED,)):
        tree = build(make_emitters(500, kinds))
        for x in (np.float32([2, 2, -1]), np.float32([2, 2, -50])):
            assert probabilities(tree, x, np.float32([0, 0, 1])).sum() == pytest.approx(1, abs=1e-4)


def test_probabilities_never_exceed_one():
    tree = build(make_emitters(300))
    for p, n in receivers(200):
        assert probabilities(tree, p, n).sum() < 1 + 1e-4


@pytest.mark.parametrize("kind", [ONE_SIDED, TWO_SIDED, ALL_WAYS, SPOT, None])
@pytest.mark.parametrize("size", [2.0, 0.05])
def test_no_light_is_left_out(kind, size):
    emitters = make_emitters(40, (kind,) if kind is not None else tuple(range(4)), seed=7, size=size)
    tree = build(emitters)
    random = np.random.default_rng(9)
    for p, n in receivers(300):
        assert_none_left_out(emitters, probabilities(tree, p, n), p, n, random)


def assert_none_left_out(emitters, chance: np.ndarray, p, n, random) -> None:
    for i in np.flatnonzero(chance == 0):
        assert contributions(emitters, i, p, n, random).max() < 1e-5, f"emitter {i} is never chosen"


def test_an_emitter_that_is_left_out_is_caught():
    emitters = make_emitters(40, (ALL_WAYS,))
    p, n = np.float32([2, 2, -1]), np.float32([0, 0, 1])
    for i in range(40):
        chance = np.where(np.arange(40) == i, 0, probabilities(build(emitters), p, n))
        with pytest.raises(AssertionError, match=f"emitter {i} is never chosen"):
            assert_none_left_out(emitters, chance, p, n, np.random.default_rng(9))


def test_lights_that_cannot_be_seen_are_never_chosen():
    """Below the horizon, and one-sided lamps from behind: nothing is spent on them."""
    centers = np.array([[0, 0, 1], [0, 0, -1], [1, 0, 1.0]])
    axes = np.array([[0, 0, -1.0], [0, 0, 1], [0, 0, 1]])
    kind = np.array([ONE_SIDED] * 3)
    tree = build((centers, axes, np.full(3, 0.2), kind, np.ones(3)))
    assert np.allclose(probabilities(tree, np.zeros(3), np.array([0, 0, 1.0])), [1, 0, 0])


def test_the_path_of_each_emitter_leads_to_it():
    tree = build(make_emitters(1000))
    for emitter, path in enumerate(tree.paths):
        row, bits = 0, int(path[0]) | int(path[1]) << 32
        while tree.integers[row, words.CHILD] >= 0:
            row = tree.integers[row, words.CHILD] + (bits & 1)
            bits >>= 1
        assert -1 - tree.integers[row, words.CHILD] == emitter
    assert len(tree.nodes) == 2 * 1000 - 1


def assert_clusters_bound_their_children(tree, nodes: np.ndarray) -> None:
    center, half = nodes[:, words.CENTER : words.CENTER + 3], nodes[:, words.HALF_SIZE : words.HALF_SIZE + 3]
    inner = np.flatnonzero(tree.integers[:, words.CHILD] >= 0)
    for side in range(2):
        child = tree.integers[inner, words.CHILD] + side
        assert np.all(center[child] - half[child] >= center[inner] - half[inner] - 1e-5)
        assert np.all(center[child] + half[child] <= center[inner] + half[inner] + 1e-5)
    children = tree.integers[inner, words.CHILD]
    assert np.allclose(nodes[inner, words.POWER], nodes[children, words.POWER] + nodes[children + 1, words.POWER])


def test_clusters_bound_their_children():
    tree = build(make_emitters(500))
    nodes = tree.nodes.astype(np.float64)
    assert_clusters_bound_their_children(tree, nodes)
    leaf = np.flatnonzero(tree.integers[:, words.CHILD] < 0)[0]
    for word, more in ((words.CENTER, 5.0), (words.HALF_SIZE, 5.0), (words.POWER, 0.1)):
        wrong = nodes.copy()
        wrong[leaf, word] += more
        with pytest.raises(AssertionError):
            assert_clusters_bound_their_children(tree, wrong)


def test_no_emitters():
    tree = build_light_tree(*(np.zeros(s, np.float32) for s in ((0, 6), (0, 3), 0, 0, 0)))
    assert call_sample_tree(tree, vec((0, 0, 0)), vec((0, 0, 1)), np.float32(0.5))[1] == 0


def test_black_emitters_are_never_chosen():
    emitters = make_emitters(4, (ALL_WAYS,))
    emitters[4][:] = [0, 1, 0, 2]
    chance = probabilities(build(emitters), np.array([2, 2, -9.0]), np.array([0, 0, 1.0]))
    assert chance[0] == chance[2] == 0
    assert chance.sum() == pytest.approx(1, abs=1e-5)


@pytest.mark.parametrize("spacing", ["same place", "line", "geometric"])
def test_degenerate_arrangements(spacing):
    count = 3000
    i = np.arange(count)
    x = {"same place": 0.0 * i, "line": i / count, "geometric": 10.0 ** (-9 + 18 * i / count)}[spacing]
    centers = np.stack([x, 0 * x, 0 * x], axis=1)
    emitters = (centers, np.tile([0, 0, 1.0], (count, 1)), np.zeros(count), np.full(count, ALL_WAYS), np.ones(count))
    tree = build(emitters)
    assert len(np.unique(-1 - tree.integers[:, words.CHILD][tree.integers[:, words.CHILD] < 0])) == count
    chance = probabilities(tree, np.array([0, 0, -1.0]), np.array([0, 0, 1.0]))
    assert np.all(np.isfinite(chance))
    assert chance.sum() == pytest.approx(1, abs=1e-3)


def test_an_emitter_beyond_all_bounds_leaves_the_others_alone():
    emitters = make_emitters(20, (ALL_WAYS,))
    emitters[0][3] = [1e25, 0, 0]
    chance = probabilities(build(emitters), np.array([2, 2, -3.0]), np.array([0, 0, 1.0]))
    assert chance.sum() == pytest.approx(1, abs=1e-3)
    assert chance[3] < 1e-3


def test_point_on_an_emitter():
    tree = build((np.zeros((1, 3)), np.array([[0, 0, 1.0]]), np.zeros(1), np.array([ALL_WAYS]), np.ones(1)))
    emitter, probability, rest = call_sample_tree(tree, vec((0, 0, 0)), vec((0, 0, 1)), np.float32(0.5))
    assert np.isfinite(probability) and np.isfinite(rest) and emitter == 0


def second_moment(chance: np.ndarray, light: np.ndarray) -> float:
    """E[estimate^2] / E[estimate]^2 of one sample; 1 is a perfect choice."""
    lit = light > 0
    return float(np.sum(light[lit] ** 2 / np.maximum(chance[lit], 1e-30)) / np.sum(light) ** 2)


def test_far_less_noise_than_a_choice_by_power():
    """2,500 small squares under a ceiling, receivers on the floor and the walls of a room of 4 m."""
    grid = np.stack(np.meshgrid(np.arange(50), np.arange(50)), axis=-1).reshape(-1, 2) * 0.08 + 0.04
    centers = np.concatenate([grid, np.full((2500, 1), 2.99)], axis=1)
    down = np.tile([0, 0, -1.0], (2500, 1))
    emitters = (centers, down, np.full(2500, 0.015), np.full(2500, TWO_SIDED), np.ones(2500))
    tree = build(emitters)
    random = np.random.default_rng(1)
    by_tree, by_power = [], []
    for i in range(60):
        if i % 2:
            p, n = random.random(3) * [4, 4, 0], np.array([0, 0, 1.0])
        else:
            p, n = random.random(3) * [0, 4, 2.9], np.array([1.0, 0, 0])
        to = centers - p
        d = np.linalg.norm(to, axis=1)
        light = np.maximum(to @ n, 0) * abs(to[:, 2]) / d**4
        by_tree.append(second_moment(probabilities(tree, p, n), light))
        by_power.append(second_moment(np.full(2500, 1 / 2500), light))
    assert np.mean(by_tree) < 1.15
    assert np.mean(by_tree) - 1 < 0.1 * (np.mean(by_power) - 1)


def test_a_hundred_thousand_emitters():
    emitters = make_emitters(100_000, (TWO_SIDED,), size=0.01)
    centers, axes, sizes, _, power = emitters
    arrays = (np.concatenate([centers - 0.01, centers + 0.01], axis=1), axes, 0 * sizes, 0 * sizes + np.pi / 2, power)
    two_sided = np.ones(len(power), bool)
    tree = build_light_tree(*arrays, two_sided=two_sided)
    chance = probabilities(tree, np.array([2, 2, -3.0]), np.array([0, 0, 1.0]))
    assert chance.sum() == pytest.approx(1, abs=1e-3)


def test_results_are_float32():
    tree = build(make_emitters(5))
    assert_float32(call_sample_tree, tree, vec((0, 0, 0)), vec((0, 0, 1)), np.float32(0.5))
    assert_float32(call_tree_probability, tree, np.int32(0), vec((0, 0, 0)), vec((0, 0, 1)))
