"""Every sampler of the registry draws as its density says; and a sampler that doesn't is caught, in each family."""

from __future__ import annotations

import ast
from pathlib import Path

import numpy as np
import pytest

from engine.kernels.registry import NO_DENSITY, SAMPLERS
from tests.statistics import chi2
from tests.statistics.adapters import ADAPTERS, broken, cases

KERNELS = Path(__file__).resolve().parents[2] / "engine" / "kernels"
# Random numbers, and choices among emitters: their own tests hold the frequencies (test_sampler, test_light_tree).
NOT_SAMPLERS = {"sample_1d", "sample_2d", "sample_tree"}


@pytest.mark.parametrize("name", cases())
def test_draws_follow_the_density(name, tmp_path):
    chi2.assert_follows(cases()[name], tmp_path, len(cases()))


@pytest.mark.parametrize("family", broken())
def test_a_broken_sampler_is_caught(family, tmp_path):
    """By the same figures, with the picture that shows where."""
    with pytest.raises(AssertionError, match="chi-squared p-value") as caught:
        chi2.assert_follows(broken()[family], tmp_path, len(cases()))
    picture = next(tmp_path.glob("*.png"))
    assert str(picture) in str(caught.value)


def test_every_family_has_an_adapter_and_a_broken_sampler():
    families = {entry.family for entry in SAMPLERS}
    assert families == set(ADAPTERS) == {name.split(",")[0] for name in broken()}


def test_every_function_that_draws_is_registered():
    """A new `sample_x` anywhere in the kernels has to be drawn by some entry, or say why it has no density."""
    known = {f.__name__ for entry in SAMPLERS for f in entry.draws} | {f.__name__ for f in NO_DENSITY} | NOT_SAMPLERS
    found = set()
    for path in KERNELS.rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.FunctionDef) and node.name.startswith(("sample_", "regular_", "concentric_")):
                found.add(node.name)
    found -= {name for name in found if name.startswith("_")}
    assert len(found) > 10
    assert found <= known, f"without an entry in engine/kernels/registry.py: {sorted(found - known)}"


def test_the_quadrature_finds_a_disk():
    """The area of a disk that crosses the cells, and the integral of a bell in one of them."""
    edge = np.linspace(-1, 1, 9)
    disk = chi2.integrate(lambda p: (np.hypot(*p.T) < 0.7).astype(float), (edge, edge))
    assert disk.sum() == pytest.approx(np.pi * 0.49, rel=3e-4)
    bell = chi2.integrate(lambda p: np.exp(-np.sum((p - 0.1) ** 2, axis=1) / 2e-4), (edge, edge), 1e-5)
    assert bell.sum() == pytest.approx(2e-4 * np.pi, rel=1e-4)
