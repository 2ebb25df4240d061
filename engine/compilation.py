"""How far a compilation is: which functions kernels are made of, and which of them are in the cache on the disk.

Numba compiles every function that a kernel calls, one after the other, and keeps each in files of its own; the kernel
itself, into which all of them are inlined, comes last. So the files tell how far it is, whichever process compiles.
"""

from __future__ import annotations

import inspect
import os
from collections.abc import Iterable, Sequence
from typing import Any

from numba.core.dispatcher import Dispatcher

from .result import Doing

PREPARING = Doing("preparing")
ONCE = "(once for each kind of scene)"


class Compilation:
    """What to say while these kernels are compiled, in this process or in another, or loaded if they are kept.

    what  the compilation is of and how often there is one, where it isn't the scene's own kernel
    """

    def __init__(self, kernels: Sequence[Dispatcher], is_kept: bool, what: tuple[str, str] = ("compiling", ONCE)):
        self._what, self._once = what
        if is_kept or all(kernel.signatures for kernel in kernels):  # the second: here, where nothing can be kept
            kernels = ()
        functions = functions_of(kernels)
        self._total = len(functions)
        # A kernel's own file may be that of other features: it counts when all is over.
        self._kernels = len(kernels)
        self._left = [_file(function) for function in functions.difference(kernels)]

    def __call__(self, seconds: float) -> Doing:
        """After so many seconds."""
        if not self._total:
            return PREPARING
        self._left = [path for path in self._left if not os.path.exists(path)]
        done = self._total - self._kernels - len(self._left)
        message = f"{self._what}: {done} of {self._total} functions, {seconds:.0f} s {self._once}"
        return Doing(message, (done, self._total))


def functions_of(kernels: Iterable[Dispatcher]) -> set[Dispatcher]:
    """The compiled functions that they are made of, themselves among them, by the names that each uses. Numba compiles
    all of these: features are constants to LLVM alone, which drops what they exclude."""
    found: set[Dispatcher] = set()
    new = list(kernels)
    while new:
        function = new.pop()
        if function not in found:
            found.add(function)
            names = inspect.getclosurevars(function.py_func)
            values = (*names.nonlocals.values(), *names.globals.values())
            new += [value for value in values if isinstance(value, Dispatcher)]
    return found


def _file(function: Any) -> str:
    """What Numba writes when it has compiled the function."""
    return function._cache._cache_file._index_path


def loading_callback(is_kept: bool, seconds: float) -> Doing:
    """What to say of functions for C to call, after so many seconds: there are two, not worth counting."""
    return PREPARING if is_kept else Doing(f"compiling, {seconds:.0f} s (once)")
