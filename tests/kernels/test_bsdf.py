"""Both lobes: drawn as the density says, with the right energy, at every exponent; nothing below the surface."""

from __future__ import annotations

import json
import math
from pathlib import Path

import numpy as np
import pytest

from engine.kernels import bsdf
from engine.kernels.bsdf.phong import phong_albedo
from engine.kernels.geom.vec import reflect
from engine.kernels.jit import kernel
from engine.settings import HEMISPHERE_SAMPLING, LOBE_SELECTION
from tests.kernels import chi2

COUNT = 100_000
COSINE, UNIFORM, REJECTION = range(3)
ALBEDO_TABLE = Path(__file__).parent / "phong_albedo.json"
UP = (0.0, 0.0, 1.0)
f32 = np.float32


@kernel
def draw(has_phong, hemisphere, surface, wo, n, ng, u, wi_out, f_out, pdf_out, lobe_out):
    rng = np.uint32(99)
    for i in range(len(u)):
        wi, f, pdf, lobe, rng, _ = bsdf.sample(
            has_phong, hemisphere, surface, wo, n, ng, u[i, 0], u[i, 1], u[i, 2], rng
        )
        pdf_out[i], lobe_out[i] = pdf, lobe
        for k in range(3):
            wi_out[i, k], f_out[i, k] = wi[k], f[k]


@kernel
def evaluate_all(has_phong, hemisphere, surface, wo, n, ng, wi, f_out, pdf_out):
    for i in range(len(wi)):
        f, pdf = bsdf.evaluate(has_phong, hemisphere, surface, wo, (wi[i, 0], wi[i, 1], wi[i, 2]), n, ng)
        pdf_out[i] = pdf
        for k in range(3):
            f_out[i, k] = f[k]


@kernel
def probability(selection, kd, ks, exponent, cos_o):
    return bsdf.phong_probability(selection, kd, ks, exponent, cos_o)


@kernel
def albedos(exponent, cos_o, out):
    for i in range(len(out)):
        out[i] = phong_albedo(exponent[i], cos_o[i])


@kernel
def mirror(w, n):
    return reflect(w, n)


class Case:
    """One surface seen from one direction, as the kernels see it."""

    def __init__(self, kd=0.0, ks=0.0, exponent=0.0, p_phong=0.0, angle=0.0, hemisphere=COSINE, n=UP, ng=UP):
        self.kd, self.ks, self.exponent, self.p_phong, self.hemisphere = kd, ks, exponent, p_phong, hemisphere
        self.n, self.ng = np.asarray(n, float), np.asarray(ng, float)
        x, _, z = chi2.frame(n)
        self.wo = np.sin(np.radians(angle)) * x + np.cos(np.radians(angle)) * z
        self.mirror = 2 * (self.wo @ self.n) * self.n - self.wo
        self.surface = (chi2.vec([kd] * 3), chi2.vec([ks] * 3), f32(exponent), f32(p_phong))
        self.arguments = (self.surface, chi2.vec(self.wo), chi2.vec(self.n), chi2.vec(self.ng))

    def draw(self, u: np.ndarray):
        """(wi, f of the first channel, pdf, lobe), float64"""
        wi, f = np.empty((2, len(u), 3), np.float32)
        pdf, lobe = np.empty(len(u), np.float32), np.empty(len(u), np.int32)
        draw(int(self.ks > 0), self.hemisphere, *self.arguments, u, wi, f, pdf, lobe)
        return wi.astype(float), f[:, 0].astype(float), pdf.astype(float), lobe

    def evaluate(self, wi: np.ndarray):
        """(f of the first channel, pdf), float64"""
        f, pdf = np.empty((len(wi), 3), np.float32), np.empty(len(wi), np.float32)
        evaluate_all(int(self.ks > 0), self.hemisphere, *self.arguments, np.asarray(wi, np.float32), f, pdf)
        return f[:, 0].astype(float), pdf.astype(float)

    def p_value(self) -> float:
        """Of the chi-squared test of `draw` against the pdf of `evaluate`."""
        wi, _, pdf, _ = self.draw(chi2.uniforms(COUNT, 3))
        wi = wi[pdf > 0]
        if self.exponent <= 10 and self.p_phong < 1:  # the sphere about the normal
            square = chi2.sphere_to_square(wi, self.n)
            return chi2.fit_p_value(square, COUNT, self.sphere_density, cells=(32, 32), inner=12)
        square = chi2.lobe_to_square(wi, self.mirror, self.exponent)
        if self.p_phong == 1:
            inner = 64 if self.exponent <= 1 else 16  # the horizon cuts many cells of the broadest lobes
            return chi2.fit_p_value(square, COUNT, self.lobe_density, cells=(16, 24), inner=inner)
        # What is drawn far outside the lobe falls into the first ring of cells: one cell, of what is left over.
        cells = (16, 24)
        masses = chi2.cell_masses(self.lobe_density, cells, 16)[1:].ravel()
        counts, _, _ = np.histogram2d(*square.T, bins=cells, range=((0, 1), (0, 1)))
        counts = counts[1:].ravel()
        assert masses.sum() <= 1
        return chi2.p_value(np.append(counts, COUNT - counts.sum()), COUNT * np.append(masses, 1 - masses.sum()))

    def sphere_density(self, points):
        return self.evaluate(chi2.square_to_sphere(points, self.n))[1] * chi2.SPHERE_AREA

    def lobe_density(self, points):
        directions, area = chi2.square_to_lobe(points, self.mirror, self.exponent)
        return self.evaluate(directions)[1] * area


TILTED = np.array([0.48, -0.6, 0.64])
BENT = chi2.frame(TILTED)[0] * 0.3 + TILTED
BENT /= np.linalg.norm(BENT)

DIFFUSE = [Case(kd=0.7, hemisphere=h, angle=30) for h in (COSINE, UNIFORM, REJECTION)]
DIFFUSE += [Case(kd=0.7, hemisphere=h, angle=30, n=TILTED, ng=BENT) for h in (COSINE, UNIFORM, REJECTION)]
PHONG = [
    Case(ks=0.9, exponent=n, p_phong=1, angle=angle)
    for n in (0, 1, 10, 100, 1e3, 1e4, 1e6)
    for angle in (0, 45, 75, 89)
]
COMBINED = [
    Case(kd=0.4, ks=0.5, exponent=n, p_phong=p, angle=angle, hemisphere=hemisphere, n=TILTED, ng=TILTED)
    for n, p, angle, hemisphere in [
        (0, 0.5, 60, COSINE),
        (1, 0.3, 30, UNIFORM),
        (10, 0.5, 80, COSINE),
        (10, 0.7, 45, REJECTION),
        (100, 0.5, 60, COSINE),
        (1e3, 0.2, 85, UNIFORM),
        (1e6, 0.5, 45, COSINE),
    ]
]
BENT_PHONG = [Case(ks=0.9, exponent=10, p_phong=1, angle=70, n=TILTED, ng=BENT)]
CASES = DIFFUSE + PHONG + COMBINED + BENT_PHONG


@pytest.mark.parametrize("case", CASES, ids=lambda c: f"{c.hemisphere}-{c.exponent:g}-{c.p_phong}")
def test_samples_follow_the_pdf(case):
    assert case.p_value() > chi2.threshold(len(CASES))


class Broken(Case):
    """A Phong lobe drawn with one exponent and evaluated with another, five per cent larger."""

    def evaluate(self, wi):
        return Case(**{**WRONG, "exponent": WRONG["exponent"] * 1.05}).evaluate(wi)


WRONG = {"ks": 0.9, "exponent": 100, "p_phong": 1, "angle": 45}


def test_the_test_catches_a_wrong_sampler():
    assert Case(**WRONG).p_value() > chi2.SIGNIFICANCE
    assert Broken(**WRONG).p_value() < 1e-9


@pytest.mark.parametrize("case", CASES, ids=lambda c: f"{c.hemisphere}-{c.exponent:g}-{c.p_phong}")
def test_sampling_ends_with_the_evaluation(case):
    """What `sample` returns is what `evaluate` says of the direction drawn, and nothing lies below the surface."""
    wi, f, pdf, _ = case.draw(chi2.uniforms(2000, 3, seed=4))
    assert np.abs(np.linalg.norm(wi, axis=1) - 1).max() < 1e-6
    f_again, pdf_again = case.evaluate(wi)
    # The lobe of exponent n turns a rounding of the direction, which the compiler may keep in more digits, into this:
    rough = 1e-5 + 2e-6 * math.sqrt(case.exponent + 1)
    assert pdf_again == pytest.approx(pdf, rel=rough, abs=1e-6 * (case.exponent + 1))
    assert f_again == pytest.approx(f, rel=rough, abs=1e-6 * (case.exponent + 1))
    below = (wi @ case.n <= -1e-6) | (wi @ case.ng <= -1e-6)
    assert not pdf[below].any()
    assert not f[below].any()


def test_nothing_on_the_other_side_of_either_normal():
    case = Case(kd=0.5, ks=0.4, exponent=2, p_phong=0.5, angle=20, n=TILTED, ng=BENT)
    wi = chi2.square_to_sphere(chi2.grid(64).astype(float))
    f, pdf = case.evaluate(wi)
    above = (wi @ case.n > 1e-6) & (wi @ case.ng > 1e-6)
    below = (wi @ case.n < -1e-6) | (wi @ case.ng < -1e-6)
    assert (pdf[above] > 0).all()
    assert (f[above] > 0).all()
    assert not pdf[below].any()
    assert not f[below].any()


def table() -> np.ndarray:
    """(rows, 3): exponent, degrees, albedo"""
    return np.array(json.loads(ALBEDO_TABLE.read_text())["rows"], float)


def test_phong_albedo_by_sampling():
    """The mean of f cos / pdf over a grid of random numbers, for every row of the table."""
    grid = chi2.grid(128)
    u = np.column_stack([np.full(len(grid), 0.5, np.float32), grid])
    for exponent, angle, expected in table():
        case = Case(ks=1, exponent=exponent, p_phong=1, angle=angle)
        wi, f, pdf, lobe = case.draw(u)
        assert (lobe == 1).all()
        valid = pdf > 0
        albedo = np.sum(f[valid] * (wi[valid] @ case.n) / pdf[valid]) / len(u)
        assert albedo == pytest.approx(expected, abs=1e-3), (exponent, angle)


def test_phong_albedo_approximation():
    """Within 1.2 % of the table, exact at normal incidence, and never outside [0, 1]."""
    rows = table()
    out = np.empty(len(rows), np.float32)
    albedos(rows[:, 0].astype(np.float32), np.cos(np.radians(rows[:, 1])).astype(np.float32), out)
    assert np.abs(out / rows[:, 2] - 1).max() < 0.012
    assert out[rows[:, 1] == 0] == pytest.approx(1, abs=1e-6)

    exponent, cosine = (a.ravel() for a in np.meshgrid(10.0 ** np.linspace(-3, 8, 100), np.linspace(0, 1, 100)))
    out = np.empty(len(exponent), np.float32)
    albedos(exponent.astype(np.float32), cosine.astype(np.float32), out)
    assert out.min() > 0
    assert out.max() <= 1 + 1e-6


@pytest.mark.parametrize("selection", range(len(LOBE_SELECTION)))
def test_estimates_do_not_depend_on_the_lobe_choice(selection):
    """Directional albedo of both lobes together, by independent samples, with the probability that is really used."""
    rows = {(n, angle): albedo for n, angle, albedo in table()}
    for exponent, angle in [(0, 60), (10, 75), (100, 85), (1000, 45)]:
        kd, ks = chi2.vec([0.5] * 3), chi2.vec([0.3] * 3)
        p_phong = probability(selection, kd, ks, f32(exponent), f32(math.cos(math.radians(angle))))
        case = Case(kd=0.5, ks=0.3, exponent=exponent, p_phong=p_phong, angle=angle)
        wi, f, pdf, lobe = case.draw(chi2.uniforms(COUNT, 3, seed=9))
        values = np.where(pdf > 0, f * (wi @ case.n) / np.maximum(pdf, 1e-30), 0)
        error = values.std() / math.sqrt(COUNT)
        assert values.mean() == pytest.approx(0.5 + 0.3 * rows[exponent, angle], abs=4 * error)
        assert lobe.mean() == pytest.approx(p_phong, abs=4 * 0.5 / math.sqrt(COUNT))


def test_albedo_selection_has_less_error_at_grazing_angles():
    errors = []
    for selection in (bsdf.ALBEDO, bsdf.CLASSIC):
        p = probability(selection, chi2.vec([0.2] * 3), chi2.vec([0.8] * 3), f32(100), f32(math.cos(math.radians(85))))
        case = Case(kd=0.2, ks=0.8, exponent=100, p_phong=p, angle=85)
        wi, f, pdf, _ = case.draw(chi2.uniforms(COUNT, 3, seed=9))
        errors.append(np.where(pdf > 0, f * (wi @ case.n) / np.maximum(pdf, 1e-30), 0).var())
    assert errors[0] < 0.5 * errors[1]


def test_lobe_probabilities():
    half, black = chi2.vec([0.5] * 3), chi2.vec([0.0] * 3)
    assert [LOBE_SELECTION[i] for i in (bsdf.ALBEDO, bsdf.CLASSIC)] == ["ALBEDO", "CLASSIC"]
    assert HEMISPHERE_SAMPLING == ("COSINE", "UNIFORM", "REJECTION")
    for selection in (bsdf.ALBEDO, bsdf.CLASSIC):
        assert probability(selection, half, black, f32(10), f32(0.5)) == 0
        assert probability(selection, black, half, f32(10), f32(0.5)) == 1
        assert probability(selection, black, black, f32(10), f32(0.5)) == 0
        assert probability(selection, half, half, f32(10), f32(1)) == pytest.approx(0.5)
    assert probability(bsdf.CLASSIC, half, chi2.vec([0.25, 0.5, 0.75]), f32(1e4), f32(0)) == pytest.approx(0.5)
    assert probability(bsdf.ALBEDO, half, half, f32(1e8), f32(0)) == pytest.approx(0.05)
    assert probability(bsdf.ALBEDO, chi2.vec([1e-4] * 3), half, f32(1), f32(1)) == pytest.approx(0.95)
    # A shading normal that looks away from the viewer.
    assert 0 < probability(bsdf.ALBEDO, half, half, f32(10), f32(-0.3)) < 0.5


@pytest.mark.parametrize("exponent", [1e3, 1e5, 1e6, 1e8])
def test_sharp_lobes_keep_their_width(exponent):
    """The sine of the angle to R, against float64: about the rounding of a direction's components."""
    u = chi2.uniforms(10_000, 3)
    case = Case(ks=1, exponent=exponent, p_phong=1)
    wi, _, pdf, _ = case.draw(u)
    sine = np.hypot(wi[:, 0], wi[:, 1])
    expected = np.sqrt(-np.expm1(2 * np.log(u[:, 1].astype(float)) / (exponent + 1)))
    assert sine == pytest.approx(expected, rel=1e-5)
    assert (pdf > 0).all()
    # seen from the side, the mirror direction itself is rounded
    wi, _, pdf, _ = Case(ks=1, exponent=exponent, p_phong=1, angle=40).draw(u)
    case = Case(ks=1, exponent=exponent, p_phong=1, angle=40)
    sine = np.linalg.norm(np.cross(wi, case.mirror), axis=1)
    assert np.sqrt(np.mean((sine - expected) ** 2)) < 3e-7


def test_tiny_density_counts_as_zero():
    case = Case(ks=1, exponent=1e6, p_phong=1)
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
                case = Case(kd=0.5, ks=0.5, exponent=exponent, p_phong=0.5, angle=angle, hemisphere=hemisphere)
                assert all(np.isfinite(a).all() for a in case.draw(u))


def test_colours_go_their_own_way():
    surface = (chi2.vec((0.1, 0.2, 0.3)), chi2.vec((0.4, 0.0, 0.2)), f32(2), f32(0.5))
    f, pdf = np.empty((1, 3), np.float32), np.empty(1, np.float32)
    up = chi2.vec(UP)
    evaluate_all(1, COSINE, surface, up, up, up, np.array([UP], np.float32), f, pdf)
    assert f[0] * np.pi == pytest.approx([0.1 + 0.4 * 2, 0.2, 0.3 + 0.2 * 2], rel=1e-6)
    assert pdf[0] * np.pi == pytest.approx(0.5 + 0.5 * 1.5, rel=1e-6)


def test_mirror_angle_through_the_bisector():
    """angle(wo, ws) = 2 angle(b, n), b the bisector of wi and wo and ws the mirror direction of wi: if all lie in one
    plane with n, and not otherwise (REFERENCE.md, section 1)."""

    def difference(wo, wi):
        ws = np.array(mirror(chi2.vec(wi), chi2.vec(UP)), float)
        bisector = (wi + wo) / np.linalg.norm(wi + wo)
        return np.arccos(np.clip(wo @ ws, -1, 1)) - 2 * np.arccos(np.clip(bisector[2], -1, 1))

    def direction(theta, phi):
        return np.array([math.sin(theta) * math.cos(phi), math.sin(theta) * math.sin(phi), math.cos(theta)])

    for theta_o, theta_i in [(0.3, 0.9), (1.2, 0.2), (0.7, 1.4)]:
        for phi in (0.0, math.pi):
            assert difference(direction(theta_o, 0), direction(theta_i, phi)) == pytest.approx(0, abs=2e-3)
        assert abs(difference(direction(theta_o, 0), direction(theta_i, 1.9))) > 0.02


def test_single_precision():
    v, color, surface = chi2.vec(UP), chi2.vec((0.1, 0.2, 0.3)), Case(kd=0.5, ks=0.4, exponent=5, p_phong=0.5).surface
    u = f32(0.5)
    chi2.assert_single_precision(bsdf.evaluate, 1, 0, surface, v, v, v, v)
    chi2.assert_single_precision(bsdf.sample, 1, 0, surface, v, v, v, u, u, u, np.uint32(1))
    chi2.assert_single_precision(bsdf.phong_probability, 0, color, color, u, u)
