"""Memory foreseen: what a scene will need, and what the computer has left, before anything large is made.

Too little of it shows late and badly: on Linux the system ends Blender without a word, elsewhere it begins to swap.
"""

from __future__ import annotations

import ctypes
import os
import sys
from collections.abc import Sequence
from pathlib import Path, PurePosixPath

import numpy as np

from .errors import LobeError
from .passes import bytes_a_pixel
from .scene import Mesh, Scene, World

# Bytes, measured with grids and loose triangles of 1 to 4 million: the tables of `pack` to the byte, Embree's structure
# with compact leaves at 28 a triangle (67 with full ones, of which there are a million at most).
OF_VERTEX, OF_NORMAL, OF_TRIANGLE, OF_NORMAL_INDICES = 12, 12, 12 + 4 + 28, 12
OF_EMISSIVE_TRIANGLE = 330  # of the light tree and what it is made from
OF_INSTANCE = 48 + 8 + 64
# Of an environment image, a texel: the tables that it is drawn by, which stay, and the first step of making them. The
# image itself is there already.
OF_TEXEL, OF_NEW_TEXEL = 4 + 1, 12 + 4
# The film's sums and counts, a picture of it, and Blender's copy.
OF_PIXEL = 4 * 8 + 4 + 4 * 4 + 4 * 4

ADVICE = (
    "close other programs, use fewer triangles (lower levels of subdivision, instances instead of copies) or smaller "
    "images, or set a lower resolution"
)
SMALL = 64_000_000  # bytes, not worth the question, which takes a millisecond: other programs come and go by more
CONTROL_GROUPS = Path("/sys/fs/cgroup")
OWN_GROUPS = Path("/proc/self/cgroup")
MEMORY = Path("/proc/meminfo")


def need_of(scene: Scene, meshes: list[Mesh], instances: int, passes: Sequence[str] = ()) -> dict[str, int]:
    """Bytes by what they are for, largest first. meshes: of those that are stored, one for each time; instances: the
    number of placements that are Embree's; passes: beside Combined."""
    triangles, vertices = sum(len(mesh.triangles) for mesh in meshes), sum(len(mesh.vertices) for mesh in meshes)
    normals = sum(len(mesh.normals) for mesh in meshes if mesh.normals is not None)
    of_meshes = OF_TRIANGLE * triangles + OF_VERTEX * vertices + OF_NORMAL * normals
    if normals and any(mesh.normals is None or mesh.normal_indices is not None for mesh in meshes):
        of_meshes += OF_NORMAL_INDICES * triangles  # else normals are numbered as vertices are
    return _largest_first(
        {
            f"{triangles:,} triangles": of_meshes,
            f"{instances:,} instances": OF_INSTANCE * instances,
            **need_of_environment(scene.world, OF_TEXEL),
            **need_of_film(scene, passes),
        }
    )


def need_of_film(scene: Scene, passes: Sequence[str] = ()) -> dict[str, int]:
    """The part of `need_of` that no surface has a share in."""
    x0, y0, x1, y1 = scene.render_region
    pixels, size = (x1 - x0) * (y1 - y0), f"{x1 - x0} x {y1 - y0} pixels"
    need = {size: OF_PIXEL * pixels}
    if passes:
        need[f"{len(passes)} passes of {size}"] = bytes_a_pixel(passes) * pixels
    return _largest_first(need)


def need_of_environment(world: World, of_texel: int) -> dict[str, int]:
    """Of the tables for its image, if it shines with one."""
    if world.image is None or not any(world.color):
        return {}
    height, width = world.image.shape[:2]
    return {f"the environment image of {width} x {height} pixels": of_texel * width * height}


def _largest_first(need: dict[str, int]) -> dict[str, int]:
    return dict(sorted(need.items(), key=lambda item: -item[1]))


def foresee(need: dict[str, int]) -> None:
    """Raises LobeError where there is certainly not so much memory. What is `SMALL` isn't asked about."""
    wanted = sum(need.values())
    if wanted <= SMALL:
        return
    there = available()
    if wanted <= there:
        return
    what, most = next(iter(need.items()))
    raise LobeError(
        f"not enough memory: rendering takes some {wanted / 1e9:.1f} GB, {most / 1e9:.1f} of it for {what}, and "
        f"{there / 1e9:.1f} GB can be had: {ADVICE}"
    )


def available() -> float:
    """Bytes that this process can still get, swap space included; infinite where the system doesn't tell."""
    if sys.platform == "win32":
        return _windows()
    if sys.platform == "darwin":  # swaps into files that grow: what is more than all there is would never end
        return float(os.sysconf("SC_PHYS_PAGES")) * os.sysconf("SC_PAGE_SIZE")
    return max(min(_linux(), _control_groups(OWN_GROUPS, CONTROL_GROUPS), _limit()), 0.0)


def _linux() -> float:
    lines = _numbers(MEMORY)
    if "MemAvailable:" not in lines:
        return np.inf
    return 1024.0 * (lines["MemAvailable:"] + lines.get("SwapFree:", 0))


def _control_groups(own: Path, mounted: Path) -> float:
    """What Linux's control groups leave: each that this process is in has a limit for all that are below it.

    own      lists the groups of this process, as hierarchy:controllers:path (cgroups(7) of the Linux manual)
    mounted  where they are. In a container that is its own group: what lies above can't be seen there
    """
    try:
        rows = [line.split(":", 2) for line in own.read_text().splitlines()]
    except OSError:
        return np.inf
    rooms = [np.inf]
    for _, controllers, path in (row for row in rows if len(row) == 3):
        group = PurePosixPath(path.lstrip("/"))
        groups = [group, *group.parents] if ".." not in group.parts else [PurePosixPath()]
        if not controllers:
            rooms += [_control_group(mounted / group) for group in groups]
        elif "memory" in controllers.split(","):
            rooms += [_old_control_group(mounted / "memory" / group) for group in groups]
    return min(rooms)


def _control_group(folder: Path) -> float:
    """By version 2 of control groups (Documentation/admin-guide/cgroup-v2.rst of the kernel).

    What is in use counts as free where the kernel takes it back before it ends a process of the group: copies of files
    (active_file, inactive_file) and of what it knows of them (slab_reclaimable). Not those that programs have mapped
    (file_mapped): their code is among them, and they crawl when it is read anew again and again. Other pages go to swap
    space, as much as the group may have and the system has left; a group that doesn't tell has none.
    """
    most, used = _bytes(folder / "memory.max"), _bytes(folder / "memory.current")
    if most is None or used is None:
        return np.inf
    stat = _numbers(folder / "memory.stat")
    copies = _copies(stat, "active_file", "inactive_file", "file_mapped")
    return most - used + copies + stat.get("slab_reclaimable", 0) + _swap(folder)


def _old_control_group(folder: Path) -> float:
    """The same by version 1 (Documentation/admin-guide/cgroup-v1/memory.rst): there the limit with swap space is one
    for memory and swap space together, and groups without it swap as they like."""
    most, used = _bytes(folder / "memory.limit_in_bytes"), _bytes(folder / "memory.usage_in_bytes")
    if most is None or used is None:
        return np.inf
    stat = _numbers(folder / "memory.stat")
    copies = _copies(stat, "total_active_file", "total_inactive_file", "total_mapped_file")
    room = most - used + copies + _free_swap()
    most, used = _bytes(folder / "memory.memsw.limit_in_bytes"), _bytes(folder / "memory.memsw.usage_in_bytes")
    return room if most is None or used is None else min(room, most - used + copies)


def _copies(stat: dict[str, int], active: str, inactive: str, mapped: str) -> int:
    """Bytes of files that the kernel can read again, by the names that they have in `memory.stat`."""
    return max(stat.get(active, 0) + stat.get(inactive, 0) - stat.get(mapped, 0), 0)


def _swap(folder: Path) -> float:
    """Bytes that a control group may still swap out."""
    most, used = _bytes(folder / "memory.swap.max"), _bytes(folder / "memory.swap.current")
    if most is None or used is None:
        return 0.0
    return min(max(most - used, 0.0), _free_swap())


def _free_swap() -> float:
    return 1024.0 * _numbers(MEMORY).get("SwapFree:", 0)


def _bytes(path: Path) -> float | None:
    """Of a file with a number, or with "max" for no limit; None where there is neither."""
    try:
        text = path.read_text().strip()
        return np.inf if text == "max" else float(int(text))
    except (OSError, ValueError):
        return None


def _limit() -> float:
    """What `ulimit -v` leaves."""
    import resource

    soft, _ = resource.getrlimit(resource.RLIMIT_AS)
    if soft == resource.RLIM_INFINITY:
        return np.inf
    try:
        pages = int(Path("/proc/self/statm").read_text().split()[0])
    except (OSError, ValueError):
        return float(soft)
    return float(soft - pages * resource.getpagesize())


def _numbers(path: Path) -> dict[str, int]:
    """Of a file with a name and a number in each line."""
    try:
        rows = [line.split() for line in path.read_text().splitlines()]
    except OSError:
        return {}
    return {row[0]: int(row[1]) for row in rows if len(row) > 1 and row[1].isdigit()}


def _windows() -> float:
    class Status(ctypes.Structure):  # MEMORYSTATUSEX of sysinfoapi.h
        _fields_ = [("size", ctypes.c_ulong), ("load", ctypes.c_ulong)] + [
            (name, ctypes.c_ulonglong)
            for name in ("total", "available", "page_total", "page_available", "own_total", "own_available", "extended")
        ]

    status = Status(size=ctypes.sizeof(Status))
    kernel32 = ctypes.WinDLL("kernel32")  # type: ignore[attr-defined]
    return float(status.page_available) if kernel32.GlobalMemoryStatusEx(ctypes.byref(status)) else np.inf
