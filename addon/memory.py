"""How much memory this process uses, on every system that Blender runs on, without a package for it; giving it back."""

from __future__ import annotations

import ctypes
import sys

_MB = 1024.0 * 1024.0


def current_and_peak_mb() -> tuple[float, float]:
    """Resident memory of the whole process in MB, now and at its highest. Blender's own share is in it."""
    if sys.platform == "win32":
        return _windows()
    import resource

    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    peak_mb = peak / _MB if sys.platform == "darwin" else peak / 1024.0  # bytes on macOS, kB on Linux
    try:
        with open("/proc/self/statm") as file:
            return int(file.read().split()[1]) * resource.getpagesize() / _MB, peak_mb
    except FileNotFoundError:  # macOS: what is in use now costs a call into Mach, so show the peak
        return peak_mb, peak_mb


def give_back() -> None:
    """What is free goes back to the system, in some milliseconds. Linux's C library (malloc_trim(3)) keeps it else, in
    pieces that the next frame may not fit into, so that over an animation the process grows."""
    if sys.platform.startswith("linux") and (trim := getattr(ctypes.CDLL(None), "malloc_trim", None)):
        trim(0)


def _windows() -> tuple[float, float]:
    class Counters(ctypes.Structure):  # PROCESS_MEMORY_COUNTERS of psapi.h
        _fields_ = [("size", ctypes.c_ulong), ("page_faults", ctypes.c_ulong)] + [
            (name, ctypes.c_size_t)
            for name in ("peak_working_set", "working_set", "a", "b", "c", "d", "page_file", "peak_page_file")
        ]

    counters = Counters(size=ctypes.sizeof(Counters))
    kernel32 = ctypes.WinDLL("kernel32")  # type: ignore[attr-defined]
    kernel32.GetCurrentProcess.restype = ctypes.c_void_p
    process = ctypes.c_void_p(kernel32.GetCurrentProcess())
    kernel32.K32GetProcessMemoryInfo(process, ctypes.byref(counters), counters.size)
    return counters.working_set / _MB, counters.peak_working_set / _MB
