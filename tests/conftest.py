"""What all tests share."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest
from tables import Tables

REPOSITORY = Path(__file__).resolve().parent.parent
TABLES = pytest.StashKey[Tables]()


@pytest.fixture(scope="session")
def repository() -> Path:
    return REPOSITORY


@pytest.fixture(scope="session")
def record(request: pytest.FixtureRequest) -> Callable[[str, tuple[str, ...], dict], None]:
    """`record(table, keys, row)` leaves a row for benchmarks/results/`table`.csv and .md; for long tests."""
    return request.config.stash.setdefault(TABLES, Tables()).record


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter, config: pytest.Config) -> None:
    """Rows go to the files at the end of the run, and are shown."""
    for name, table in config.stash.get(TABLES, Tables()).write():
        terminalreporter.section(f"written to benchmarks/results/{name}.md")
        terminalreporter.write(table)
