"""The worked claims of the derivations, each with its figure: see the table at the end of the run."""

from __future__ import annotations

import json
import math
import os
import subprocess
import sys
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest
from scipy import stats

from engine.kernels.geom.vec import reflect
from engine.kernels.jit import kernel
from tests.statistics import chi2
from tests.statistics.surfaces import REJECTION, Hemisphere, Surface

ALBEDO_TABLE = Path(__file__).resolve().parents[1] / "kernels" / "phong_albedo.json"
CONFIDENCE = 0.99
COUNT = 400_000


def half_width(values: np.ndarray, tests: int = 1) -> float:
    """Of the confidence interval of the mean, where so many intervals have to hold at once (Sidak)."""
    return stats.norm.ppf((1 + CONFIDENCE ** (1 / tests)) / 2) * values.std(ddof=1) / math.sqrt(len(values))


def test_rejection_needs_12_over_pi_draws(figure):
    """The count is a sum of geometric variables of success pi / 12, whose deviation is known."""
    case = Hemisphere(REJECTION)
    case.draw(COUNT, 1)
    mean, accepted = case.needed / COUNT, math.pi / 12
    width = stats.norm.ppf((1 + CONFIDENCE) / 2) * math.sqrt((1 - accepted) / COUNT) / accepted
    figure(f"rejection sampling: {mean:.5f} draws, 12/pi = {12 / math.pi:.5f} +- {width:.5f} (99 %)")
    assert abs(mean - 12 / math.pi) < width
    assert abs(mean - 6 / math.pi) > 100 * width  # had lower points been mirrored up


ALBEDO = {(n, angle): albedo for n, angle, albedo in json.loads(ALBEDO_TABLE.read_text())["rows"]}


class Mixed(NamedTuple):
    """A material of both lobes, seen at an angle."""

    kd: float
    ks: float
    exponent: float
    angle: float

    @property
    def albedo(self) -> float:
        return self.kd + self.ks * ALBEDO[self.exponent, self.angle]

    def __str__(self) -> str:
        return f"kd {self.kd:g}, ks {self.ks:g}, n = {self.exponent:g}, {self.angle:g} degrees"


def estimates(seen: Mixed, drawn: float, a: float, b: float) -> np.ndarray:
    """f cos / (a pdf_diffuse + b pdf_phong) of directions of which the compiled sampler drew the share `drawn` from
    the Phong lobe; their mean ought to be the directional albedo."""
    kd, ks, exponent, angle = seen
    case = Surface(kd, ks, exponent, drawn, angle)
    wi, f, pdf, _ = case.sample(chi2.uniforms(COUNT, 3, seed=7))
    diffuse = Surface(kd, 0, exponent, 0, angle).evaluate(wi)[1]
    phong = Surface(0, ks, exponent, 1, angle).evaluate(wi)[1]
    assert np.allclose(pdf, (1 - drawn) * diffuse + drawn * phong, rtol=2e-5, atol=1e-7), "the compiled density"
    return np.where(pdf > 0, f * (wi @ case.n) / np.maximum(a * diffuse + b * phong, 1e-30), 0)


MIXED = (Mixed(0.5, 0.3, 30, 60), Mixed(0.1, 0.8, 1, 30), Mixed(0.3, 0.6, 100, 85), Mixed(0.6, 0.2, 1000, 0))
WEIGHTS = (0.02, 0.2, 0.375, 0.5, 0.8, 0.98)
NOT_ONE = ((0.6, 0.6), (0.4, 0.4), (0.5, 0.3))


@pytest.mark.parametrize("b", WEIGHTS)
@pytest.mark.parametrize("seen", MIXED, ids=str)
def test_any_weights_that_sum_to_1_are_unbiased(seen, b, figure):
    values, exact = estimates(seen, b, 1 - b, b), seen.albedo
    mean, width = values.mean(), half_width(values)
    figure(f"combined pdf, {seen}, a = {1 - b:.3f}, b = {b:.3f}: {mean:.5f} +- {width:.5f} (99 %), exact {exact:.5f}")
    assert abs(mean - exact) < half_width(values, len(WEIGHTS) * len(MIXED))
    assert width < 0.03 * exact


@pytest.mark.parametrize("a, b", NOT_ONE)
@pytest.mark.parametrize("seen", MIXED, ids=str)
def test_weights_that_do_not_sum_to_1_are_biased(seen, a, b, figure):
    """Draws are shared as a : b; the mean is off by 1 / (a + b)."""
    values, exact = estimates(seen, b / (a + b), a, b), seen.albedo
    mean, width = values.mean(), half_width(values)
    figure(f"combined pdf, {seen}, a + b = {a + b:.1f}: {mean:.5f} +- {width:.5f} (99 %), exact {exact:.5f}: biased")
    assert abs(mean - exact) > 20 * width
    assert mean == pytest.approx(exact / (a + b), abs=half_width(values, len(NOT_ONE) * len(MIXED)))


@kernel
def mirror(w, n):
    return reflect(w, n)


def bisector_difference(theta_o: float, theta_i: float, phi: float) -> float:
    """angle(wo, ws) - 2 angle(b, n) in radians, ws the mirror direction of wi and b the bisector of wi and wo."""

    def direction(theta, turn):
        return np.array([math.sin(theta) * math.cos(turn), math.sin(theta) * math.sin(turn), math.cos(theta)])

    wo, wi = direction(theta_o, 0), direction(theta_i, phi)
    ws = np.array(mirror(chi2.vec(wi), chi2.vec((0, 0, 1))), float)
    bisector = (wi + wo) / np.linalg.norm(wi + wo)
    # Angles through arc tangents, which keep the digits of small ones.
    angle = 2 * math.atan2(np.linalg.norm(wo - ws), np.linalg.norm(wo + ws))
    return angle - 2 * math.atan2(np.hypot(bisector[0], bisector[1]), bisector[2])


def test_the_bisector_identity_holds_in_the_plane_and_fails_out_of_it(figure):
    angles = [0.05, 0.3, 0.7, 1.2, 1.5]
    pairs = [(o, i) for o in angles for i in angles]
    inside = max(abs(bisector_difference(o, i, phi)) for o, i in pairs for phi in (0.0, math.pi))
    outside = [abs(bisector_difference(o, i, phi)) for o, i in pairs if min(o, i) > 0.2 for phi in (0.4, 1.2, 1.9, 2.8)]
    figure(
        f"bisector identity: off by {inside:.1e} rad at most in the plane, by {min(outside):.3f} to "
        f"{max(outside):.3f} rad out of it"
    )
    assert inside < 2e-6
    assert min(outside) > 1e-3
    assert max(outside) > 0.3


def directional_albedo(case: Surface) -> float:
    """Integral of f cos by adaptive quadrature of the compiled evaluation, over rings that fit the lobe."""
    quantiles = np.concatenate([np.arange(1, 32) / 32, 1 - 0.5 ** np.arange(6, 26)])
    drops = -np.expm1(np.log1p(-quantiles) / (case.exponent + 1))
    edges = np.unique(np.concatenate([[0], drops, [1]])), np.linspace(0, 2 * np.pi, 17)
    sphere = chi2.Sphere(case.mirror, edges)

    def reflected(parameters):
        wi = sphere.points(parameters)
        return case.evaluate(wi)[0] * np.maximum(wi @ case.n, 0)

    return float(chi2.integrate(reflected, edges, tolerance=2e-3).sum())


def test_the_phong_albedo_of_the_compiled_kernels(figure):
    worst, at = 0.0, (0.0, 0.0)
    for (exponent, angle), expected in ALBEDO.items():
        error = directional_albedo(Surface(ks=1, exponent=exponent, p_phong=1, angle=angle)) / expected - 1
        if abs(error) > abs(worst):
            worst, at = error, (exponent, angle)
    figure(f"Phong albedo: {len(ALBEDO)} rows, worst relative error {worst:.1e} at n = {at[0]:g}, {at[1]:g} degrees")
    assert abs(worst) < 1e-3


def test_a_wrong_exponent_misses_the_albedo_table():
    """The check of the table, broken on purpose: half a per cent more exponent where the lobe meets the horizon."""
    case = Surface(ks=1, exponent=10 * 1.05, p_phong=1, angle=85)
    assert abs(directional_albedo(case) / ALBEDO[10, 85] - 1) > 1e-3


def test_figures_are_shown_by_workers_too(repository):
    """As `make test` runs: the terminal is the controller's, the figures are the workers'."""
    done = subprocess.run(
        [sys.executable, "-m", "pytest", "-q", "-n", "2", "-p", "no:cacheprovider", __file__, "-k", "rejection"],
        cwd=repository,
        env={name: value for name, value in os.environ.items() if not name.startswith("PYTEST_")},
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stdout
    claims = done.stdout.partition("worked claims")[2]
    assert f"12/pi = {12 / math.pi:.5f} +- " in claims, done.stdout
    assert claims.count("12/pi") == 1
