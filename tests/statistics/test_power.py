"""The cases of test_samplers.py with thirty times the draws, and every surface of the whole grid: minutes, so `long`.

At this power errors of one per cent in a parameter are refused. Each case is a row of benchmarks/results/samplers.md.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context

import pytest

from engine.settings import HEMISPHERE_SAMPLING, LOBE_SELECTION
from tests.statistics import chi2
from tests.statistics.adapters import cases, fine_twins
from tests.statistics.surfaces import whole_grid

DRAWS, GRID_DRAWS = 3_000_000, 100_000
PROCESSES = min(os.cpu_count() or 1, 2)
TABLE = "samplers"
pytestmark = pytest.mark.long


def judged(name: str) -> chi2.Result:
    return chi2.chi_squared({**cases(), **fine_twins()}[name], DRAWS, chi2.THOROUGH)


def judged_surfaces(index: int) -> list[chi2.Result]:
    """All of the grid with this lobe selection and hemisphere."""
    selection, hemisphere = divmod(index, len(HEMISPHERE_SAMPLING))
    return [chi2.chi_squared(case, GRID_DRAWS) for case in whole_grid(selection, hemisphere)]


def shared(function: Callable, given: list) -> Iterator:
    """In processes that inherit what is compiled."""
    with ProcessPoolExecutor(PROCESSES, get_context("fork")) as pool:
        yield from pool.map(function, given)


def row(what: str, result: chi2.Result, tests: int) -> dict:
    return {
        "case": what,
        "draws": result.count,
        "failed": f"{result.failed[0] / result.count:.4f}",
        "integral + failed - 1": f"{result.excess:+.1e}",
        "allowed": f"{result.excess_allowed:.1e}",
        "p": f"{result.p_value:.2g}",
        "verdict": "follows" if result.passes(tests) else "REFUSED",
    }


def test_all_cases_at_full_power(record):
    names = list(cases())
    judged(names[0])
    refused = []
    for name, result in zip(names, shared(judged, names), strict=True):
        record(TABLE, ("case",), row(name, result, len(names)))
        refused += [] if result.passes(len(names)) else [name]
    assert not refused


def test_errors_of_one_per_cent_are_refused(record):
    for what, case in fine_twins().items():
        result = chi2.chi_squared(case, DRAWS, chi2.THOROUGH)
        record(TABLE, ("case",), row(f"wrong on purpose: {what}", result, len(cases())))
        assert not result.passes(len(cases())), what


def test_the_whole_grid_of_surfaces(record):
    """kd, ks, both coloured, x exponents x angles: a row for each lobe selection and hemisphere has the worst."""
    next(whole_grid(0, 0)).density(chi2.sphere_points(2))
    every = list(shared(judged_surfaces, list(range(len(LOBE_SELECTION) * len(HEMISPHERE_SAMPLING)))))
    tests = sum(map(len, every))
    for i, results in enumerate(every):
        selection, hemisphere = divmod(i, len(HEMISPHERE_SAMPLING))
        worst = min(results, key=lambda result: result.p_value)
        what = f"grid of {len(results)}, {LOBE_SELECTION[selection]} {HEMISPHERE_SAMPLING[hemisphere]}, worst"
        record(TABLE, ("case",), row(what, worst, tests))
        assert not [result.name for result in results if not result.passes(tests)]
