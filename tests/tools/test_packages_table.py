"""benchmarks/packages.py on a made-up zip whose sizes are known."""

from __future__ import annotations

import io
import zipfile

import pytest


@pytest.fixture(scope="module")
def packages(script):
    return script("packages")


def wheel(size: int) -> bytes:
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("module.py", b"\0" * size)
        archive.writestr("more.py", b"\0" * 1_000_000)
    return file.getvalue()


def test_a_zips_contents(packages, tmp_path):
    """Of two wheels of a library one is installed; wheels are packed as they are."""
    path = tmp_path / "lobe.zip"
    wheels = {"numba-0.1.2-cp311-cp311-win_amd64.whl": 2_000_000, "numba-0.1.2-cp313-cp313-win_amd64.whl": 3_000_000,
              "pure-3-py3-none-any.whl": 0}  # fmt: skip
    with zipfile.ZipFile(path, "w") as file:
        file.writestr("__init__.py", b"\0" * 1_500_000)
        file.writestr("engine/__init__.py", b"\0" * 500_000)
        for name, size in wheels.items():
            file.writestr(f"wheels/{name}", wheel(size))
        file.writestr("docs/wheels.whl", b"\0" * 500_000)  # none of the package's libraries
    rows = {row["part"]: row for row in packages.contents(path, "windows-x64")}
    assert list(rows) == [packages.OWN, "numba", "pure", packages.WHOLE]
    assert {row["system"] for row in rows.values()} == {"windows-x64"}
    assert (rows["numba"]["version"], rows["numba"]["for Python"]) == ("0.1.2", "cp311, cp313")
    installed = {part: row["MB installed"] for part, row in rows.items()}
    assert installed == {packages.OWN: "2.5", "numba": "4.0", "pure": "1.0", packages.WHOLE: "7.5"}
    assert rows[packages.OWN]["MB in the zip"] == "2.5" and rows["numba"]["MB in the zip"] == "0.0"
    assert rows[packages.WHOLE]["MB in the zip"] == f"{path.stat().st_size / 1e6:.1f}"
