"""The worked claims are printed with their figures at the end of the run, whether they held or not."""

from __future__ import annotations

import pytest

FIGURES = pytest.StashKey[list[str]]()


@pytest.fixture
def figure(request):
    """Call it with a line for the table of figures."""
    lines = request.config.stash.setdefault(FIGURES, [])
    return lines.append


def pytest_terminal_summary(terminalreporter, config):
    lines = config.stash.get(FIGURES, [])
    if lines:
        terminalreporter.section("worked claims")
        for line in lines:
            terminalreporter.line(line)
