"""What all tests share."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest
from tables import Tables

REPOSITORY = Path(__file__).resolve().parent.parent
TABLES = pytest.StashKey[Tables]()
FIGURE = "worked claim"


class Claims:
    """The lines of `figure`, in the order of the tests. With `pytest -n` it is the controller that gets the reports and
    has a terminal, while fixtures run in workers: reports carry the lines across."""

    def __init__(self) -> None:
        self.lines: dict[str, list[str]] = {}

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        if report.when == "call":
            self.lines[report.nodeid] = [str(line) for name, line in report.user_properties if name == FIGURE]

    def pytest_terminal_summary(self, terminalreporter: pytest.TerminalReporter) -> None:
        lines = [line for test in self.lines.values() for line in test]
        if lines:
            terminalreporter.section("worked claims")
        for line in lines:
            terminalreporter.line(line)


def pytest_configure(config: pytest.Config) -> None:
    config.pluginmanager.register(Claims())


@pytest.fixture(scope="session")
def repository() -> Path:
    return REPOSITORY


@pytest.fixture(scope="session")
def record(request: pytest.FixtureRequest) -> Callable[[str, tuple[str, ...], dict], None]:
    """`record(table, keys, row)` leaves a row for benchmarks/results/`table`.csv and .md; for long tests."""
    return request.config.stash.setdefault(TABLES, Tables()).record


@pytest.fixture
def figure(request: pytest.FixtureRequest) -> Callable[[str], None]:
    """Call it with a line for the worked claims at the end of the run, which are printed whether they held or not."""
    return lambda line: request.node.user_properties.append((FIGURE, line))


@pytest.fixture
def pass_as_written() -> Callable[[str, str, int], None]:
    """`pass_as_written(file, keyword, count)`: so many tests of a file pass in a process of their own, where kernels
    calculate as is written (see `engine/kernels/jit.py`)."""

    def check(file: str, keyword: str, count: int) -> None:
        done = subprocess.run(
            [sys.executable, "-m", "pytest", "-q", "-k", keyword, file],
            env={**os.environ, "LOBE_CALCULATE_AS_WRITTEN": "1"},
            capture_output=True,
            text=True,
        )
        assert done.returncode == 0 and f"{count} passed" in done.stdout, done.stdout

    return check


@pytest.fixture
def counted_calls() -> Callable[[Callable[[], object]], int]:
    """`counted_calls(function)` says how many calls Python makes for it: what a clock can't tell on a busy machine."""

    def count(function: Callable[[], object]) -> int:
        calls = 0

        def note(_frame, event, _argument):
            nonlocal calls
            calls += event in ("call", "c_call")

        sys.setprofile(note)
        try:
            function()
        finally:
            sys.setprofile(None)
        return calls

    return count


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter, config: pytest.Config) -> None:
    """Rows go to the files at the end of the run, and are shown."""
    for name, table in config.stash.get(TABLES, Tables()).write():
        terminalreporter.section(f"written to benchmarks/results/{name}.md")
        terminalreporter.write(table)
