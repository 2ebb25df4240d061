"""Both lobes: the choice between them, sharp lobes and extreme numbers. How they are drawn: tests/statistics."""

from __future__ import annotations

import json
import math
from pathlib import Path

import numpy as np
import pytest

from engine.kernels import bsdf
from engine.kernels.bsdf.phong import phong_albedo
from engine.kernels.jit import kernel
from engine.settings import HEMISPHERE_SAMPLING, LOBE_SELECTION
from tests.statistics import chi2
from tests.statistics.surfaces import COSINE, REJECTION, UNIFORM, Surface, evaluate_surface, phong_probability

COUNT = 100_000
ALBEDO_TABLE = Path(__file__).parent / "phong_albedo.json"
UP = (0.0, 0.0, 1.0)
f32 = np.float32


@kernel
def albedos(exponent, cos_o, out):
    for i in range(len(out)):
        out[i] = phong_albedo(exponent[i], cos_o[i])


def table() -> np.ndarray:
    """(rows, 3): exponent, degrees, albedo"""
    return np.array(json.loads(ALBEDO_TABLE.read_text())["rows"], float)


def assert_albedo_is_near_the_table(factor: float = 1.0) -> None:
    """With every exponent times `factor`."""
    rows = table()
    out = np.empty(len(rows), np.float32)
    albedos((rows[:, 0] * factor).astype(np.float32), np.cos(np.radians(rows[:, 1])).astype(np.float32), out)
    assert np.abs(out / rows[:, 2] - 1).max() < 0.012
    assert out[rows[:, 1] == 0] == pytest.approx(1, abs=1e-6)


def test_phong_albedo_approximation():
    """Within 1.2 % of the table, exact at normal incidence, and never outside [0, 1]."""
    assert_albedo_is_near_the_table()
    exponent, cosine = (a.ravel() for a in np.meshgrid(10.0 ** np.linspace(-3, 8, 100), np.linspace(0, 1, 100)))
    out = np.empty(len(exponent), np.float32)
    albedos(exponent.astype(np.float32), cosine.astype(np.float32), out)
    assert out.min() > 0
    assert out.max() <= 1 + 1e-6


def test_the_albedo_of_another_exponent_is_caught():
    for factor in (0.97, 1.03):
        with pytest.raises(AssertionError):
            assert_albedo_is_near_the_table(factor)


def test_albedo_selection_has_less_error_at_grazing_angles():
    errors = []
    for selection in (bsdf.ALBEDO, bsdf.CLASSIC):
        case = Surface(kd=0.2, ks=0.8, exponent=100, angle=85, selection=selection)
        wi, f, pdf, _ = case.sample(chi2.uniforms(COUNT, 3, seed=9))
        errors.append(np.where(pdf > 0, f * (wi @ case.n) / np.maximum(pdf, 1e-30), 0).var())
    assert errors[0] < 0.5 * errors[1]


def test_lobe_probabilities():
    half, black = chi2.vec([0.5] * 3), chi2.vec([0.0] * 3)
    assert [LOBE_SELECTION[i] for i in (bsdf.ALBEDO, bsdf.CLASSIC)] == ["ALBEDO", "CLASSIC"]
    assert HEMISPHERE_SAMPLING == ("COSINE", "UNIFORM", "REJECTION")
    for selection in (bsdf.ALBEDO, bsdf.CLASSIC):
        assert phong_probability(selection, half, black, f32(10), f32(0.5)) == 0
        assert phong_probability(selection, black, half, f32(10), f32(0.5)) == 1
        assert phong_probability(selection, black, black, f32(10), f32(0.5)) == 0
        assert phong_probability(selection, half, half, f32(10), f32(1)) == pytest.approx(0.5)
    assert phong_probability(bsdf.CLASSIC, half, chi2.vec([0.25, 0.5, 0.75]), f32(1e4), f32(0)) == pytest.approx(0.5)
    assert phong_probability(bsdf.ALBEDO, half, half, f32(1e8), f32(0)) == pytest.approx(0.05)
    assert phong_probability(bsdf.ALBEDO, chi2.vec([1e-4] * 3), half, f32(1), f32(1)) == pytest.approx(0.95)
    # A shading normal that looks away from the viewer.
    assert 0 < phong_probability(bsdf.ALBEDO, half, half, f32(10), f32(-0.3)) < 0.5


def sines(u: np.ndarray, exponent: float) -> np.ndarray:
    """Of the angles to R that a lobe has to be drawn at by random numbers u, float64."""
    return np.sqrt(-np.expm1(2 * np.log(u[:, 1].astype(float)) / (exponent + 1)))


@pytest.mark.parametrize("exponent", [1e3, 1e5, 1e6, 1e8])
def test_sharp_lobes_keep_their_width(exponent):
    """The sine of the angle to R, against float64: about the rounding of a direction's components."""
    u = chi2.uniforms(10_000, 3)
    case = Surface(ks=1, exponent=exponent, p_phong=1)
    wi, _, pdf, _ = case.sample(u)
    sine, expected = np.hypot(wi[:, 0], wi[:, 1]), sines(u, exponent)
    assert sine == pytest.approx(expected, rel=1e-5)
    assert (pdf > 0).all()
    # seen from the side, the mirror direction itself is rounded
    wi, _, pdf, _ = Surface(ks=1, exponent=exponent, p_phong=1, angle=40).sample(u)
    case = Surface(ks=1, exponent=exponent, p_phong=1, angle=40)
    sine = np.linalg.norm(np.cross(wi, case.mirror), axis=1)
    assert np.sqrt(np.mean((sine - expected) ** 2)) < 3e-7


@pytest.mark.parametrize("exponent", [1e3, 1e5, 1e6, 1e8])
def test_the_sine_of_a_rounded_cosine_has_another_width(exponent):
    """What the test of sharp lobes is there for: cos(alpha) = u^(1 / (n + 1)) in float32."""
    u = chi2.uniforms(10_000, 3)
    cosine = np.power(u[:, 1], f32(1 / (exponent + 1)))
    assert np.sqrt(1 - cosine * cosine) != pytest.approx(sines(u, exponent), rel=1e-5)


def test_tiny_density_counts_as_zero():
    case = Surface(ks=1, exponent=1e6, p_phong=1)
    wi = np.array([[0.2, 0, math.sqrt(0.96)], [0, 0, 1]])
    f, pdf = case.evaluate(wi)
    assert (f[0], pdf[0]) == (0, 0)
    assert pdf[1] == pytest.approx((1e6 + 1) / (2 * np.pi), rel=1e-6)
    assert f[1] == pytest.approx((1e6 + 2) / (2 * np.pi), rel=1e-6)


def test_extreme_random_numbers_give_finite_results():
    ends = np.array([2.0**-24, 0.5, 1 - 2.0**-24], np.float32)
    u = np.stack(np.meshgrid(ends, ends, ends), axis=-1).reshape(-1, 3)
    for exponent in (0, 1, 1e3, 1e8):
        for angle in (0, 60, 90):
            for hemisphere in (COSINE, UNIFORM, REJECTION):
                case = Surface(kd=0.5, ks=0.5, exponent=exponent, p_phong=0.5, angle=angle, hemisphere=hemisphere)
                assert all(np.isfinite(a).all() for a in case.sample(u))


def test_colours_go_their_own_way():
    surface = (chi2.vec((0.1, 0.2, 0.3)), chi2.vec((0.4, 0.0, 0.2)), f32(2), f32(0.5))
    f, pdf = np.empty((1, 3), np.float32), np.empty(1, np.float32)
    up = chi2.vec(UP)
    evaluate_surface(1, COSINE, surface, up, up, up, np.array([UP], np.float32), f, pdf)
    assert f[0] * np.pi == pytest.approx([0.1 + 0.4 * 2, 0.2, 0.3 + 0.2 * 2], rel=1e-6)
    assert pdf[0] * np.pi == pytest.approx(0.5 + 0.5 * 1.5, rel=1e-6)


def test_single_precision():
    v, color, surface = (
        chi2.vec(UP),
        chi2.vec((0.1, 0.2, 0.3)),
        Surface(kd=0.5, ks=0.4, exponent=5, p_phong=0.5).surface,
    )
    u = f32(0.5)
    chi2.assert_single_precision(bsdf.evaluate, 1, 0, surface, v, v, v, v)
    chi2.assert_single_precision(bsdf.sample, 1, 0, surface, v, v, v, u, u, u, np.uint32(1))
    chi2.assert_single_precision(bsdf.phong_probability, 0, color, color, u, u)
