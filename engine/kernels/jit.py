"""The one place that compiles: the decorators of every kernel, and where the compiled code is kept on disk.

`kernel` is for the few functions that Python calls, `device` for those that kernels call. Nothing is compiled when
this module is imported.
"""

from __future__ import annotations

import contextlib
import getpass
import hashlib
import os
import shutil
import stat
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

import embreex
import llvmlite
import numba
from numba.core.compiler_lock import global_compiler_lock
from numba.core.registry import cpu_target

from .halfway import intermediate_code_only

KERNEL_FOLDER = Path(__file__).resolve().parent
KEPT_VERSIONS = 3  # of the kernels: going back to the version before doesn't compile again

# LLVM may reorder sums and contract products into them, and does so by what stands beside them: the same formula in two
# kernels may differ by a rounding. What that saves is the
# trial "arithmetic that may be reordered" of benchmarks/trials.py. With this variable at 1 it calculates as is written,
# for tests that compare bits. No 'nnan' and no 'ninf' ever: the film's check for what is not finite must survive.
AS_WRITTEN = os.environ.get("LOBE_CALCULATE_AS_WRITTEN") == "1"


def _source_hash() -> str:
    """Hash of every kernel source, of the packages that they are compiled with, and of the processor.

    Numba notices an edit of a function's own file and a new version of itself, but neither an edit of a callee's file
    nor new versions of llvmlite and Embree. It does notice another processor, but to itself: that something has been
    compiled must be certain from the folder alone.
    """
    digest = hashlib.sha256(b"as written" if AS_WRITTEN else b"")
    for package in (numba, llvmlite, embreex):
        digest.update(f"{package.__name__} {package.__version__}\0".encode())
    digest.update(repr(cpu_target.target_context.codegen().magic_tuple()).encode())  # by which Numba tells them apart
    for path in [KERNEL_FOLDER.parent / "features.py", *sorted(KERNEL_FOLDER.rglob("*.py"))]:
        digest.update(path.relative_to(KERNEL_FOLDER.parent).as_posix().encode())
        digest.update(path.read_bytes())
    return digest.hexdigest()[:16]


def _user() -> str:
    """As tools/lobe_blender.py names its folder: users of one name in two containers are still two users."""
    return str(os.getuid()) if hasattr(os, "getuid") else getpass.getuser()


def _cache_folder() -> Path:
    """Where the compiled kernels of these sources are kept.

    In LOBE_CACHE_DIR if set (the add-on sets Blender's extension user folder), else in the temporary folder. Where
    neither can be written, in a new folder: the kernels then compile once for each process, which is better than not
    at all.
    """
    shared = Path(tempfile.gettempdir()) / f"lobe-cache-{_user()}"
    places = [shared]
    if chosen := os.environ.get("LOBE_CACHE_DIR"):
        places.insert(0, Path(chosen))
    for place in places:
        folder = place / "kernels" / _source_hash()
        if (place is not shared or _is_ours(place)) and _is_writable(folder):
            return folder
    return Path(tempfile.mkdtemp(prefix="lobe-cache-"))


def _is_ours(folder: Path) -> bool:
    """Make the folder for this user alone. The temporary folder is everybody's, and what lies in a cache is run:
    what another user has put there under our name doesn't count. Only systems with owners share that folder."""
    try:
        folder.mkdir(mode=0o700, exist_ok=True)
        if hasattr(os, "getuid"):
            status = folder.lstat()
            if not stat.S_ISDIR(status.st_mode) or status.st_uid != os.getuid():
                return False
            folder.chmod(0o700)
    except OSError:
        return False
    return True


def _is_writable(folder: Path) -> bool:
    """Asked by writing, which alone is certain on every system; a full disk counts as read-only."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder) as file:
            file.write(b"x")
    except OSError:
        return False
    return True


def _prune(newest: Path) -> None:
    """Delete the kernels of all but the newest versions. `newest` is in use and counts as the first of them."""
    if newest.parent.name != "kernels":
        return
    with contextlib.suppress(OSError):  # another process may do the same; what is left goes next time
        os.utime(newest)
        folders = sorted((f for f in newest.parent.iterdir() if f != newest), key=lambda f: f.stat().st_mtime)
        for folder in folders[: max(len(folders) - KEPT_VERSIONS + 1, 0)]:
            shutil.rmtree(folder, ignore_errors=True)


CACHE_FOLDER = _cache_folder()
_prune(CACHE_FOLDER)


def lost_cache() -> str:
    """What to tell the user where compiled kernels can't be kept; empty where they can."""
    if CACHE_FOLDER.parent.name == "kernels":
        return ""
    places = [place for place in (os.environ.get("LOBE_CACHE_DIR"), tempfile.gettempdir()) if place]
    return f"compiled kernels are lost at the end, as {' and '.join(map(repr, places))} can't be written to"


FASTMATH: set[str] = set() if AS_WRITTEN else {"contract", "reassoc", "nsz", "arcp", "afn"}

_OPTIONS = {
    "error_model": "numpy",
    "nogil": True,
    "cache": True,
    "fastmath": FASTMATH,
    # No reference counts: kernels allocate nothing, and counting the arrays that they hand to each other, with atomic
    # instructions that all threads share, made two threads four times slower.
    "_nrt": False,
}


@contextlib.contextmanager
def _own_cache() -> Iterator[None]:
    """Numba looks up its cache folder when a function is decorated. Other add-ons' functions keep their own."""
    with global_compiler_lock:
        before = numba.config.CACHE_DIR
        numba.config.CACHE_DIR = str(CACHE_FOLDER)
        try:
            yield
        finally:
            numba.config.CACHE_DIR = before


def _one_writer_at_a_time(dispatcher):
    """Numba numbers its files without a lock. Where two processes write at once, one number may go to two functions,
    and one of them would be taken for the other from then on."""
    file = dispatcher._cache._cache_file
    save = file.save

    def save_alone(key, data):
        with alone(Path(f"{file._index_path}.lock")):
            save(key, data)

    file.save = save_alone
    return dispatcher


@contextlib.contextmanager
def alone(path: Path) -> Iterator[None]:
    """Waits until no other thread or process is in here with this file. Closing it lets go, as does the end of a
    process."""
    with path.open("ab") as file:
        with contextlib.suppress(OSError):  # on a disk that knows no locks it is as it was without
            if sys.platform == "win32":
                import msvcrt

                msvcrt.locking(file.fileno(), msvcrt.LK_LOCK, 1)
            else:
                import fcntl

                fcntl.flock(file, fcntl.LOCK_EX)
        yield


def device(function):
    """Compile a function that kernels call. Python cannot: there is nothing to call, and the process ends in a crash.

    Inlined by force, so that the features, constants of the outermost kernel, reach every branch. It is optimised as
    a part of that kernel, and has neither machine code nor wrappers for Python and C: with all of them the first
    compilation takes more than twice as long.
    """
    with _own_cache():
        dispatcher = numba.njit(forceinline=True, no_cpython_wrapper=True, no_cfunc_wrapper=True, **_OPTIONS)(function)
    compile_to_the_end = dispatcher.compile

    def compile_halfway(signature):
        with intermediate_code_only():
            return compile_to_the_end(signature)

    dispatcher.compile = compile_halfway
    return _one_writer_at_a_time(dispatcher)


def kernel(function):
    """Compile a function that Python calls with packed arrays."""
    with _own_cache():
        return _one_writer_at_a_time(numba.njit(**_OPTIONS)(function))


def callback(signature: str):
    """Compile a function for C to call, at once. It runs on any thread and without the interpreter's lock."""

    def compile_it(function):
        with _own_cache():
            return numba.cfunc(signature, cache=True)(function)

    return compile_it
