"""The environment image: the lookup of `engine.scene.World`, and a sampler that follows it."""

from __future__ import annotations

import numpy as np
import pytest
from light_checks import assert_float32, from_python, vec

from engine.kernels.geom.vec import LUMINANCE
from engine.kernels.jit import kernel
from engine.kernels.light.environment import (
    build_environment,
    environment_irradiance,
    environment_lookup,
    sample_environment,
)
from engine.scene import World
from tests.statistics import chi2
from tests.statistics.lights import world_case

call_sample_environment = from_python(sample_environment)
call_environment_lookup = from_python(environment_lookup)


@kernel
def draw(table, u, out):
    for i in range(len(u)):
        d, radiance, pdf = sample_environment(table, u[i, 0], u[i, 1])
        out[i, 0], out[i, 1], out[i, 2] = d
        out[i, 3], out[i, 4], out[i, 5] = radiance
        out[i, 6] = pdf


@kernel
def look_up(table, directions, out):
    for i in range(len(directions)):
        radiance, pdf = environment_lookup(table, (directions[i, 0], directions[i, 1], directions[i, 2]))
        out[i, 0], out[i, 1], out[i, 2] = radiance
        out[i, 3] = pdf


def random_image(height: int, width: int, seed: int = 1) -> np.ndarray:
    return (np.random.default_rng(seed).random((height, width, 3)) ** 4).astype(np.float32)


def hot_pixel(height: int, width: int, row: int, column: int, background: float = 0.0) -> np.ndarray:
    image = np.full((height, width, 3), background, np.float32)
    image[row, column] = 1e6
    return image


IMAGES = {
    "random": random_image(16, 32),
    "not a power of two": random_image(13, 29),
    "one texel": np.full((1, 1, 3), 2, np.float32),
    "one row": random_image(1, 8),
    "one column": random_image(8, 1),
    "hot pixel": hot_pixel(16, 32, 10, 5),
    "hot pixel on the seam": hot_pixel(16, 32, 10, 31),
    "hot pixel straight up": hot_pixel(16, 32, 15, 7),
    "hot pixel straight down": hot_pixel(16, 32, 0, 0),
    "hot pixel before a sky": hot_pixel(64, 128, 40, 17, background=1.0),
    "lower half black": np.where(np.arange(16)[:, None, None] < 8, 0, random_image(16, 32)).astype(np.float32),
    "blue only": random_image(16, 32) * np.array([0, 0, 1], np.float32),
}


def random_numbers(count: int, seed: int = 1) -> np.ndarray:
    return np.minimum(np.random.default_rng(seed).random((count, 2)), 1 - 2**-24).astype(np.float32)


def samples(table, u: np.ndarray):
    """(directions, radiance, pdf) float64"""
    out = np.zeros((len(u), 7), np.float32)
    draw(table, u, out)
    return out[:, :3].astype(np.float64), out[:, 3:6].astype(np.float64), out[:, 6].astype(np.float64)


def direction_of(u: np.ndarray, v: np.ndarray) -> np.ndarray:
    """Inverse of the mapping in the docstring of `engine.scene.World`."""
    a, sine = np.pi * (2 * u - 1), np.sin(np.pi * v)
    return np.stack([np.cos(a) * sine, -np.sin(a) * sine, -np.cos(np.pi * v)], axis=-1)


def uv_of(d: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    u = (1 - np.arctan2(d[..., 1], d[..., 0]) / np.pi) / 2
    return u, np.arctan2(np.hypot(d[..., 0], d[..., 1]), -d[..., 2]) / np.pi


def bilinear(image: np.ndarray, d: np.ndarray) -> np.ndarray:
    """The lookup as the docstring of `World` says, in float64."""
    height, width, _ = image.shape
    u, v = uv_of(d)
    x, y = u * width - 0.5, np.clip(v * height - 0.5, 0, height - 1)
    i, j = np.floor(x).astype(int), np.floor(y).astype(int)
    fx, fy = (x - i)[..., None], (y - j)[..., None]
    above = np.minimum(j + 1, height - 1)
    low = image[j, i % width] * (1 - fx) + image[j, (i + 1) % width] * fx
    high = image[above, i % width] * (1 - fx) + image[above, (i + 1) % width] * fx
    return low * (1 - fy) + high * fy


def random_directions(count: int) -> np.ndarray:
    d = np.random.default_rng(5).normal(size=(count, 3))
    d /= np.linalg.norm(d, axis=1, keepdims=True)
    # Close to the poles, where the azimuth is still defined, and along the axes and the seam.
    special = [[1e-6, 1e-6, 1], [-1e-6, 1e-7, -1], [1, 1e-8, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0]]
    return np.concatenate([special, d]).astype(np.float32)


def assert_looks_up(stored: np.ndarray, image: np.ndarray) -> None:
    """Looked up in `stored`, directions show `image`."""
    d = random_directions(5000)
    out = np.zeros((len(d), 4), np.float32)
    look_up(build_environment(stored), d, out)
    assert np.allclose(out[:, :3], bilinear(image, d.astype(np.float64)), rtol=1e-4, atol=2e-5 * image.max())
    assert np.all(out[:, 3][out[:, :3].max(axis=1) > 1e-6 * image.max()] > 0), "light that is never sampled"


@pytest.mark.parametrize("name", IMAGES)
def test_lookup_is_the_bilinear_interpolation_of_the_world(name):
    assert_looks_up(IMAGES[name], IMAGES[name])


RANDOM = IMAGES["random"]
WRONG = {
    "one row up": np.roll(RANDOM, 1, axis=0),
    "mirrored": RANDOM[:, ::-1],
    "brighter": RANDOM * np.float32(1.001),
}


@pytest.mark.parametrize("name", WRONG)
def test_a_lookup_of_another_image_is_caught(name):
    with pytest.raises(AssertionError):
        assert_looks_up(WRONG[name], RANDOM)


def assert_samples_are_looked_up(drawn: np.ndarray, image: np.ndarray) -> None:
    """Samples of one image are worth what a lookup in the other tells."""
    count = 100_000
    d, radiance, pdf = samples(build_environment(drawn), random_numbers(count))
    assert np.all(pdf > 0)
    assert np.allclose(np.linalg.norm(d, axis=1), 1, atol=1e-6)
    again = np.zeros((count, 4), np.float32)
    look_up(build_environment(image), d.astype(np.float32), again)
    # Relative to the largest: close to the edge of a hot pixel the rounding of d is most of the value.
    scale = radiance.max()
    assert np.allclose(again[:, :3], radiance, rtol=1e-3, atol=1e-3 * scale)
    assert np.mean(np.abs(again[:, 3] - pdf) > 1e-2 * pdf) < 0.02


@pytest.mark.parametrize("name", IMAGES)
def test_sampling_and_looking_up_agree(name):
    assert_samples_are_looked_up(IMAGES[name], IMAGES[name])


@pytest.mark.parametrize("name", ["one row up", "mirrored"])
def test_samples_of_another_image_are_caught(name):
    with pytest.raises(AssertionError):
        assert_samples_are_looked_up(WRONG[name], RANDOM)


@pytest.mark.parametrize("name", IMAGES)
def test_samples_follow_the_density(name, tmp_path):
    case = world_case(name, World(color=(1.0, 1.0, 1.0), image=IMAGES[name]))
    chi2.assert_follows(case, tmp_path, len(IMAGES))


@pytest.mark.parametrize("name", ["random", "not a power of two", "hot pixel", "lower half black", "blue only"])
def test_irradiance_is_the_first_two_bands(name):
    """E(n) = pi <L> + integral of L w / 2 . n, both integrals from the samples. Rough in the cells at the poles."""
    table = build_environment(IMAGES[name])
    side = 256
    grid = (np.arange(side) + 0.5) / side
    u = np.stack(np.meshgrid(grid, grid), axis=-1).reshape(-1, 2).astype(np.float32)
    d, radiance, pdf = samples(table, u)
    light = (radiance / pdf[:, None]) @ LUMINANCE
    expected = np.array([np.mean(light) / 4, *(np.mean(light[:, None] * d, axis=0) / 2)])
    assert np.allclose(environment_irradiance(table), expected, atol=2e-2 * expected[0])


def test_irradiance_of_a_constant_and_of_a_bright_spot():
    assert environment_irradiance(build_environment(np.full((32, 64, 3), 3, np.float32))) == pytest.approx(
        [3 * np.pi, 0, 0, 0], rel=1e-2, abs=1e-3
    )
    spot = environment_irradiance(build_environment(hot_pixel(64, 128, 40, 17)))
    towards = direction_of(np.array(17.5 / 128), np.array(40.5 / 64))
    assert spot[1:] / np.linalg.norm(spot[1:]) == pytest.approx(towards, abs=1e-3)
    assert np.linalg.norm(spot[1:]) == pytest.approx(2 * spot[0], rel=1e-3)


@pytest.mark.parametrize("row", [0, 1, 20, 40, 63])
def test_a_hot_pixel_is_sampled_almost_without_noise(row):
    image = hot_pixel(64, 128, row, 17, background=1e-3)
    _, radiance, pdf = samples(build_environment(image), random_numbers(20_000))
    weight = radiance[:, 0] / pdf
    limit = 0.5 if row in (0, 1, 63) else 0.03  # beside a pole theta varies by its own size within a cell
    assert np.std(weight) < limit * np.mean(weight)


def test_stratification_survives():
    """Neighbours in u1 are neighbours in v, save for jumps between the few cells."""
    table = build_environment(IMAGES["random"])
    u = np.full((2000, 2), 0.3, np.float32)
    u[:, 0] = (np.arange(2000) + 0.5) / 2000
    v = uv_of(samples(table, u)[0])[1]
    assert np.all(np.diff(v) > -1e-6)


def test_extreme_random_numbers():
    for image in IMAGES.values():
        table = build_environment(image)
        last = np.float32(1 - 2**-24)
        u = np.array([[0, 0], [0, last], [last, 0], [last, last]], np.float32)
        d, radiance, pdf = samples(table, u)
        assert np.all(np.isfinite(d)) and np.all(np.isfinite(radiance)) and np.all(np.isfinite(pdf))


def test_a_black_image_has_no_density():
    table = build_environment(np.zeros((4, 8, 3), np.float32))
    _, radiance, pdf = call_sample_environment(table, np.float32(0.3), np.float32(0.4))
    assert pdf == 0 and radiance == (0, 0, 0)
    assert call_environment_lookup(table, vec((0, 0, 1))) == ((0, 0, 0), 0)
    assert np.all(environment_irradiance(table) == 0)


def test_results_are_float32():
    table, half = build_environment(IMAGES["random"]), np.float32(0.5)
    assert_float32(call_sample_environment, table, half, half)
    assert_float32(call_environment_lookup, table, vec((0, 0, 1)))
