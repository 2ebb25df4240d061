"""Compiling functions for kernels to inline: as far as LLVM's intermediate code, and no further.

Numba optimises every function that it compiles and makes machine code of it. Of a function that is inlined wherever
it is called both are thrown away, and they are a quarter of the time that the first compilation takes. Numba has no
option for it, so this replaces two methods of its code library. The package brings the version that it is made for.
"""

from __future__ import annotations

import contextlib
from collections.abc import Iterator

from numba.core.codegen import JITCodeLibrary
from numba.core.compiler_lock import global_compiler_lock
from numba.core.registry import cpu_target


class _IntermediateLibrary(JITCodeLibrary):
    """Code that is there to be linked into other code. Nobody can call it."""

    def _optimize_final_module(self) -> None:
        """It is optimised where it is inlined."""

    def _finalize_final_module(self) -> None:
        self._finalize_dynamic_globals()
        self._finalized = True

    def serialize_using_object_code(self) -> tuple:
        """What Numba's disk cache keeps."""
        return self.serialize_using_bitcode()


def _no_environment(name: str, environment: object) -> None:
    """An environment holds the Python objects that a function uses. These use none, and have no place for it."""


@contextlib.contextmanager
def intermediate_code_only() -> Iterator[None]:
    """What is compiled in this context can be called by compiled functions alone, which link it."""
    with global_compiler_lock:
        own = cpu_target.target_context.codegen().__dict__
        replaced = {"_library_class": _IntermediateLibrary, "set_env": _no_environment}
        before = {name: own[name] for name in replaced if name in own}
        try:
            own.update(replaced)
            yield
        finally:
            for name in replaced:
                own.pop(name, None)
            own.update(before)
