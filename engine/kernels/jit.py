"""The one place that compiles: the decorators of every kernel, and where the compiled code is kept on disk.

`kernel` is for the few functions that Python calls, `device` for those that kernels call. Nothing is compiled when
this module is imported.
"""

from __future__ import annotations

import getpass
import hashlib
import os
import tempfile
from pathlib import Path

KERNEL_FOLDER = Path(__file__).resolve().parent


def _source_hash() -> str:
    """Hash of every kernel source. Numba notices an edit of a function's own file, but not of its callees' files."""
    digest = hashlib.sha256()
    for path in [KERNEL_FOLDER.parent / "features.py", *sorted(KERNEL_FOLDER.rglob("*.py"))]:
        digest.update(path.relative_to(KERNEL_FOLDER.parent).as_posix().encode())
        digest.update(path.read_bytes())
    return digest.hexdigest()[:16]


def _cache_folder() -> Path:
    """In LOBE_CACHE_DIR if set (the add-on sets Blender's extension user folder), else in the temporary folder."""
    root = os.environ.get("LOBE_CACHE_DIR") or Path(tempfile.gettempdir()) / f"lobe-cache-{getpass.getuser()}"
    return Path(root) / "kernels" / _source_hash()


CACHE_FOLDER = _cache_folder()
os.environ["NUMBA_CACHE_DIR"] = str(CACHE_FOLDER)

import numba  # noqa: E402  (reads NUMBA_CACHE_DIR when it is imported)

numba.config.CACHE_DIR = str(CACHE_FOLDER)  # numba may have been imported before, by another add-on

_OPTIONS = {
    "error_model": "numpy",
    "nogil": True,
    "cache": True,
    # No 'nnan' and no 'ninf': the film's check for values that are not finite must survive optimisation.
    "fastmath": {"contract", "reassoc", "nsz", "arcp", "afn"},
    # No reference counts: kernels allocate nothing, and counting the arrays that they hand to each other, with atomic
    # instructions that all threads share, made two threads four times slower.
    "_nrt": False,
}


def device(function):
    """Compile a function that kernels call and Python doesn't.

    Inlined by force, so that the features, constants of the outermost kernel, reach every branch. Without the
    wrappers for Python and C the first compilation takes 10 s instead of 17.
    """
    return numba.njit(forceinline=True, no_cpython_wrapper=True, no_cfunc_wrapper=True, **_OPTIONS)(function)


def kernel(function):
    """Compile a function that Python calls with packed arrays."""
    return numba.njit(**_OPTIONS)(function)
