"""Both lobes beyond their samples: reciprocity, energy, one density, and the float64 reference."""

from __future__ import annotations

import numpy as np
import pytest

from engine.kernels import bsdf
from engine.reference import bsdf as reference
from engine.settings import HEMISPHERE_SAMPLING, LOBE_SELECTION
from tests.statistics import chi2
from tests.statistics.adapters import cases
from tests.statistics.drawn import BENT, TILTED
from tests.statistics.surfaces import ANGLES, EXPONENTS, Surface, evaluate_surface

f32 = np.float32
SURFACES = [case for case in cases().values() if isinstance(case, Surface)]


def tolerance(exponent: float) -> float:
    """Of float32 against float64, relative, where a lobe is above a hundredth of its peak: some roundings, of which a
    lobe multiplies those of the direction by sqrt(n). Measured: 4e-6 up to n = 1e3, 6e-6 at 1e4, 8e-5 at 1e6."""
    return 5e-6 + 2e-7 * np.sqrt(exponent + 1)


WEIGHT = 5e-6  # of f cos / pdf, relative: the lobe cancels. Measured: 2e-6
FAINT = 1e-6  # of the tails, as a part of the peak


def directions(case: Surface, count: int = 2000, seed: int = 3) -> np.ndarray:
    """Directions as the surface draws them, and some of the whole sphere; float32 values."""
    drawn = case.sample(chi2.uniforms(count, 3, seed))[0]
    return np.concatenate([drawn, chi2.sphere_points(24).astype(np.float32)])


def assert_ends_with_evaluation(case: Surface, evaluated: Surface) -> None:
    """What `sample` returns is what `evaluate` says of the direction drawn: f cos / pdf is the weight, either way."""
    wi, f, pdf, _ = case.sample(chi2.uniforms(2000, 3, seed=4))
    assert np.abs(np.linalg.norm(wi, axis=1) - 1).max() < 1e-6
    again, pdf_again = evaluated.evaluate(wi)
    # The compiler may keep a direction in more digits before it is stored.
    near_horizon = np.minimum(np.abs(wi @ case.n), np.abs(wi @ case.ng)) < 1e-6
    both = (pdf > 0) & (pdf_again > 0)
    assert ((pdf > 0) == (pdf_again > 0))[~near_horizon].mean() > 0.999
    weight, weight_again = (g[both] * (wi[both] @ case.n) / p[both] for g, p in ((f, pdf), (again, pdf_again)))
    assert np.allclose(weight_again, weight, rtol=WEIGHT, atol=1e-7)
    assert np.allclose(pdf_again[both], pdf[both], rtol=5 * tolerance(case.exponent))
    below = (wi @ case.n <= -1e-6) | (wi @ case.ng <= -1e-6)
    assert not pdf[below].any()
    assert not f[below].any()


@pytest.mark.parametrize("case", SURFACES, ids=str)
def test_sampling_ends_with_the_evaluation(case):
    assert_ends_with_evaluation(case, case)


@pytest.mark.parametrize(
    "change", [{"kd": 0.4001}, {"ks": 0.5001}, {"exponent": 100.1}, {"p_phong": 0.5001}, {"angle": 60.01}], ids=str
)
def test_sampling_that_does_not_end_with_the_evaluation_is_caught(change):
    """One part in some thousands of any parameter."""
    surface = {"kd": 0.4, "ks": 0.5, "exponent": 100, "p_phong": 0.5, "angle": 60}
    with pytest.raises(AssertionError):
        assert_ends_with_evaluation(Surface(**surface), Surface(**{**surface, **change}))


def lobes_of(case: Surface, count: int) -> reference.Lobes:
    color = np.ones((count, 3))
    n, ng = np.asarray(case.n, np.float32).astype(float), np.asarray(case.ng, np.float32).astype(float)
    return reference.Lobes(
        kd=color * np.float32(case.kd).astype(float),
        ks=color * np.float32(case.ks).astype(float),
        exponent=np.full(count, float(f32(case.exponent))),
        normal=np.tile(n, (count, 1)),
        flat=np.tile(ng, (count, 1)),
        phong_share=np.full(count, float(f32(case.p_phong))),
        hemisphere=HEMISPHERE_SAMPLING[case.hemisphere],
    )


def assert_is_reference(case: Surface, wanted: Surface) -> None:
    """f and pdf of the compiled kernels against the reference road, for the same float32 directions."""
    wi = directions(case).astype(np.float32).astype(float)
    f, pdf = case.evaluate(wi)
    wo = np.tile(np.asarray(case.wo, np.float32).astype(float), (len(wi), 1))
    diffuse, phong, wanted_pdf = reference.evaluate(lobes_of(wanted, len(wi)), wo, wi)
    wanted_f = (diffuse + phong)[:, 0]
    clear = np.minimum(np.abs(wi @ case.n), np.abs(wi @ case.ng)) > 1e-6
    peak = np.max(case.ks) * (case.exponent + 2) / (2 * np.pi) + np.max(case.kd)
    assert np.allclose(f[clear], wanted_f[clear], rtol=tolerance(case.exponent), atol=FAINT * peak)
    assert np.allclose(pdf[clear], wanted_pdf[clear], rtol=tolerance(case.exponent), atol=FAINT * peak)


@pytest.mark.parametrize("case", SURFACES, ids=str)
def test_float32_is_the_float64_reference(case):
    assert_is_reference(case, case)


@pytest.mark.parametrize("exponent", [10, 1e4])
def test_another_exponent_than_the_references_is_caught(exponent):
    """By one part in some thousands."""
    with pytest.raises(AssertionError):
        assert_is_reference(Surface(0.4, 0.5, exponent, 0.5, 60), Surface(0.4, 0.5, exponent * 1.0005, 0.5, 60))


def asymmetry(exponent: float, by_cosine: bool = False) -> float:
    """The largest difference between f(wo, wi) and f(wi, wo), relative, for pairs near the mirror direction and for
    any. by_cosine: of f / cos theta_o, as Phong's lobe stood before it was made reciprocal."""
    surface = (chi2.vec([0.4] * 3), chi2.vec([0.5] * 3), f32(exponent), f32(0.5))
    n = chi2.vec(TILTED)
    worst = 0.0
    for angle in ANGLES:
        case = Surface(0.4, 0.5, exponent, 0.5, angle, n=TILTED)
        wi = directions(case, 40).astype(np.float32)
        wi = wi[(wi @ TILTED > 1e-4)][::3]
        there = case.evaluate(wi)[0]
        if by_cosine:
            there = there / (case.wo @ TILTED) * (wi @ TILTED)
        back = np.empty((len(wi), 3), np.float32)
        wo = np.asarray([case.wo], np.float32)
        for i, w in enumerate(wi):
            evaluate_surface(1, 0, surface, chi2.vec(w), n, n, wo, back[i : i + 1], np.empty(1, np.float32))
        worst = max(worst, np.max(np.abs(back[:, 0] - there) / np.maximum(there, 0.02 * there.max())))
    return worst


@pytest.mark.parametrize("exponent", EXPONENTS)
def test_reciprocity(exponent):
    assert asymmetry(exponent) < tolerance(exponent)


@pytest.mark.parametrize("exponent", EXPONENTS)
def test_a_lobe_that_is_not_reciprocal_is_caught(exponent):
    assert asymmetry(exponent, by_cosine=True) > 10 * tolerance(exponent)


def assert_conserves(case: Surface, u: np.ndarray) -> None:
    wi, f, pdf, _ = case.sample(u)
    weight = np.where(pdf > 0, f * (wi @ case.n) / np.maximum(pdf, 1e-30), 0)
    assert weight.mean() < 1 + 1e-5 + 4 * weight.std() / np.sqrt(len(u)), case.name
    assert (weight >= 0).all()


@pytest.mark.parametrize("selection", range(len(LOBE_SELECTION)))
@pytest.mark.parametrize("hemisphere", range(len(HEMISPHERE_SAMPLING)))
def test_energy(selection, hemisphere):
    """With kd + ks = 1 nothing reflects more than it receives, and with both 0 nothing at all."""
    u = np.column_stack([chi2.uniforms(128 * 128, 1, seed=2), chi2.grid(128)])
    for kd, ks in ((0.0, 1.0), (0.5, 0.5), (1.0, 0.0)):
        for exponent in EXPONENTS:
            for angle in ANGLES:
                assert_conserves(Surface(kd, ks, exponent, None, angle, hemisphere, selection=selection), u)
    assert not Surface(0, 0, 10, None, 30).evaluate(chi2.sphere_points(16))[0].any()


def test_the_check_of_energy_can_fail():
    """A lobe of exponent 10 normalised with n + 3 for n + 2."""
    case = Surface(0, 13 / 12, 10, None, 0)
    with pytest.raises(AssertionError):
        assert_conserves(case, np.column_stack([chi2.uniforms(128 * 128, 1), chi2.grid(128)]))


@pytest.mark.parametrize("selection", range(len(LOBE_SELECTION)))
def test_lobes_are_drawn_as_often_as_the_probability_says(selection):
    for exponent, angle in [(0, 60), (10, 75), (100, 85), (1000, 45)]:
        case = Surface(0.5, 0.3, exponent, None, angle, selection=selection)
        lobe = case.sample(chi2.uniforms(100_000, 3, seed=9))[3]
        counts = np.bincount(lobe, minlength=2)
        assert chi2.p_value(counts, 1e5 * np.array([1 - case.p_phong, case.p_phong])) > chi2.threshold(8)
    assert (bsdf.DIFFUSE_LOBE, bsdf.PHONG_LOBE) == (0, 1)


def test_nothing_on_the_other_side_of_either_normal():
    case = Surface(0.5, 0.4, 2, 0.5, 20, n=TILTED, ng=BENT)
    wi = chi2.sphere_points(64)
    f, pdf = case.evaluate(wi)
    above = (wi @ case.n > 1e-6) & (wi @ case.ng > 1e-6)
    below = (wi @ case.n < -1e-6) | (wi @ case.ng < -1e-6)
    assert (pdf[above] > 0).all()
    assert (f[above] > 0).all()
    assert not pdf[below].any()
    assert not f[below].any()
