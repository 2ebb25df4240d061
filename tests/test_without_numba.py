"""Where Numba can't be imported the picture still comes out, and the report says why it took so long."""

from __future__ import annotations

import subprocess
import sys

import pytest

RENDER = """
import sys
sys.path.insert(0, "tests")
{block}
import scenes
from engine import Settings, render
result = render(scenes.furnace(), Settings(samples=1, road="{road}"))
assert result.pixels.shape[2] == 4 and result.rays > 0
assert "engine.schedule" not in sys.modules
assert result.road == "REFERENCE"
print(*result.warnings, sep="\\n")
"""

MISSING = 'sys.modules["numba"] = None'
BROKEN = """
class Broken:
    def find_spec(self, name, path=None, target=None):
        if name == "numba":
            raise {error}

sys.meta_path.insert(0, Broken())
"""


def warnings_of(block: str, repository, road: str = "COMPILED") -> str:
    code = RENDER.format(block=block, road=road)
    done = subprocess.run([sys.executable, "-c", code], cwd=repository, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return done.stdout.strip()


@pytest.mark.parametrize(
    ("block", "why"),
    [
        (MISSING, "import of numba halted; None in sys.modules"),
        (BROKEN.format(error='ImportError("Numba needs NumPy 2.1 or less")'), "Numba needs NumPy 2.1 or less"),
        (BROKEN.format(error='OSError("libllvmlite.so\\nmore")'), "libllvmlite.so"),
    ],
)
def test_the_reference_road_steps_in(block: str, why: str, repository) -> None:
    expected = f"Numba cannot be used ({why}): rendered by the slow reference road"
    assert warnings_of(block, repository) == expected


def test_another_numba_than_the_kernels_are_made_for(repository) -> None:
    other = "import numba.core.codegen; del numba.core.codegen.JITCodeLibrary"
    assert "Numba cannot be used (cannot import name 'JITCodeLibrary'" in warnings_of(other, repository)


def test_numba_that_is_told_not_to_compile(repository) -> None:
    told = 'import os; os.environ["NUMBA_DISABLE_JIT"] = "1"'
    expected = "Numba cannot be used (NUMBA_DISABLE_JIT is set): rendered by the slow reference road"
    assert warnings_of(told, repository) == expected


def test_the_reference_road_by_choice_is_nothing_to_warn_of(repository) -> None:
    assert warnings_of(MISSING, repository, road="REFERENCE") == ""
