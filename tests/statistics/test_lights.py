"""Lights beyond their samples: what a draw is worth is what a ray that meets the light is told, on both roads."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from engine.kernels.registry import SAMPLERS
from engine.reference.lights import ImageWorld, make_lamp
from tests.statistics import chi2, exact
from tests.statistics.adapters import ADAPTERS, broken, cases
from tests.statistics.lights import Light, lamp_case

LIGHTS = [case for case in cases().values() if isinstance(case, Light)]
# Relative, of float32: of what depends on the direction smoothly, and of images, between whose pixels it is steep.
SMOOTH, STEEP = 1e-4, 2e-2
# Of densities, relative. Measured: 6e-7; of worlds 7e-5, between a pixel 1e4 times as bright as the next and that one.
DENSITY, WORLD_DENSITY = 2e-6, 2e-4
RIM = 2e-3  # share of draws so near to a rim or an edge that rounding decides


def assert_drawn_is_seen(case: Light, looked_at: Light) -> None:
    """(radiance, pdf) of a draw, and of a ray along it: the two that multiple importance sampling compares."""
    out = case.sample(chi2.uniforms(5000, 3, seed=2))
    out = out[out[:, 7] > 0]
    if not len(out):  # from behind: then no ray is told anything, either
        assert not looked_at.seen(chi2.sphere_points(64))[:, :3].any()
        return
    seen = looked_at.seen(out[:, :3])
    limit = STEEP if "world" in case.name else SMOOTH
    met = seen[:, 3] > 0
    assert met.mean() > 1 - RIM
    assert np.mean(np.abs(seen[met, 3] / out[met, 7] - 1) > limit) <= RIM
    if not case.packed.features.mesh_emitters:  # there a ray asks the material
        largest = max(out[:, 4:7].max(), 1e-30)
        assert np.mean(np.abs(seen[met, :3] - out[met, 4:7]).max(axis=1) > limit * largest) <= RIM
    assert np.abs(np.linalg.norm(out[:, :3], axis=1) - 1).max() < 1e-6


@pytest.mark.parametrize("case", LIGHTS, ids=str)
def test_what_is_drawn_is_what_is_seen(case):
    assert_drawn_is_seen(case, case)


@pytest.mark.parametrize("family", [name for name, pair in broken().items() if isinstance(pair.drawn, Light)])
def test_what_is_drawn_but_not_seen_is_caught(family):
    """The pairs of lights, a little different, by which the chi-squared test is broken, too."""
    pair = broken()[family]
    assert_drawn_is_seen(pair.drawn, pair.drawn)
    with pytest.raises(AssertionError):
        assert_drawn_is_seen(pair.drawn, pair.told)


@pytest.mark.parametrize("entry", [e for e in SAMPLERS if e.family in ("lamp", "sun")], ids=lambda e: e.name)
def test_float32_sees_the_radiance_of_the_reference(entry):
    for case in ADAPTERS[entry.family](entry):
        if isinstance(case, Light):
            emitter = make_lamp(case.scene.lights[0], 1.0)
            _same_radiance(case, emitter)


@pytest.mark.parametrize("entry", [e for e in SAMPLERS if e.family == "world"], ids=lambda e: e.name)
def test_float32_sees_the_world_of_the_reference(entry):
    for case in ADAPTERS["world"](entry):
        if isinstance(case, Light):
            _same_radiance(case, ImageWorld(case.scene.world, 1.0), 1e-3)


def _same_radiance(case: Light, emitter, limit: float = 5e-4) -> None:
    out = case.sample(chi2.uniforms(5000, 3, seed=3))
    out = out[out[:, 7] > 0]
    points, normals = (np.tile(v, (len(out), 1)) for v in (case.p, case.n))
    wanted = emitter.meet(points, normals, out[:, :3])[1]
    largest = max(wanted.max(initial=0), 1e-30)
    wrong = np.abs(out[:, 4:7] - wanted).max(axis=1, initial=0) > limit * largest
    assert wrong.sum() <= RIM * len(out)


@pytest.mark.parametrize("case", LIGHTS, ids=str)
def test_float32_has_the_density_of_float64(case):
    """One over the solid angle or the area, for the directions and distances that the kernels draw."""
    _same_density(case, case)


def _same_density(case: Light, other: Light) -> None:
    out = case.sample(chi2.uniforms(2000, 3, seed=4))
    out = out[out[:, 7] > 0]
    if len(out):
        off = np.abs(out[:, 7] / exact.density(other, out[:, :3], out[:, 3]) - 1)
        assert off.max() < (WORLD_DENSITY if case.scene.world.image is not None else DENSITY)


@pytest.mark.parametrize("name", ["PointLight", "AreaLight spread 3.1", "AreaLight ellipse spread 3.1"])
def test_the_comparison_of_densities_can_fail(name):
    """A lamp that is larger by 1e-5."""
    lamp = next(entry.example for entry in SAMPLERS if entry.name == name)
    size = "radius" if name == "PointLight" else "size_x"
    larger = replace(lamp, **{size: getattr(lamp, size) * (1 + 1e-5)})
    one, other = (lamp_case(name, x, make_lamp(x, 1.0), (0.1, 0.3, -1.0), (0, 0, 1)) for x in (lamp, larger))
    _same_density(one, one)
    with pytest.raises(AssertionError):
        _same_density(one, other)


def test_the_comparison_with_the_reference_can_fail():
    entry = next(e for e in SAMPLERS if e.name == "SpotLight")
    lamp = entry.example
    case = lamp_case("spot", lamp, make_lamp(lamp, 1.0), (0.1, 0.3, -1.0), (0, 0, 1))
    _same_radiance(case, make_lamp(lamp, 1.0))
    with pytest.raises(AssertionError):
        _same_radiance(case, make_lamp(type(lamp)("wider", intensity=lamp.intensity, radius=0.5, half_angle=0.72), 1.0))
