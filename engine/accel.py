"""Embree scenes over packed arrays: the host side of ray tracing.

Buffers are shared with Embree, never copied, so `Accel` keeps every array that Embree points into alive. The
kernels only get the address of the top scene.
"""

from __future__ import annotations

import ctypes
import threading
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np

from .errors import LobeError
from .kernels.embree import build_monitor, lamp_filter, library
from .memory import ADVICE
from .settings import usable_processors

_P, _U, _Z = ctypes.c_void_p, ctypes.c_uint, ctypes.c_size_t

# Numbers of Embree 4's headers, rtcore_geometry.h, rtcore_buffer.h and rtcore_common.h.
_TRIANGLE, _SPHERE_POINT, _INSTANCE_ARRAY = 0, 50, 122
_INDEX, _VERTEX, _TRANSFORM = 0, 1, 23
_UINT3, _FLOAT3, _FLOAT4, _FLOAT3X4_ROW_MAJOR = 0x5003, 0x9003, 0x9004, 0x9134
_BUILD_QUALITY_MEDIUM = 1
# Rays don't slip between neighbouring triangles: where a dark room has a bright sky outside one that does is a firefly.
# What it costs is the trial "not watertight" of benchmarks/trials.py.
_SCENE_FLAG_ROBUST = 4
# Leaves that hold the numbers of vertices, not the vertices: less memory and quicker to build, and slower to trace (the
# trial "leaves that hold numbers of vertices"). For scenes of so many triangles that the former count.
_SCENE_FLAG_COMPACT = 2
_MOST_IN_FULL = 1 << 20  # triangles
PRIMITIVES_PER_THREAD = 4096  # that a further thread is worth starting for

_SIGNATURES = {
    "rtcNewDevice": (_P, [ctypes.c_char_p]),
    "rtcGetDeviceError": (ctypes.c_int, [_P]),
    "rtcNewScene": (_P, [_P]),
    "rtcReleaseScene": (None, [_P]),
    "rtcJoinCommitScene": (None, [_P]),
    "rtcSetSceneBuildQuality": (None, [_P, ctypes.c_int]),
    "rtcSetSceneFlags": (None, [_P, ctypes.c_int]),
    "rtcSetSceneProgressMonitorFunction": (None, [_P, _P, _P]),
    "rtcAttachGeometry": (_U, [_P, _P]),
    "rtcNewGeometry": (_P, [_P, ctypes.c_int]),
    "rtcReleaseGeometry": (None, [_P]),
    "rtcCommitGeometry": (None, [_P]),
    "rtcSetGeometryMask": (None, [_P, _U]),
    "rtcSetGeometryIntersectFilterFunction": (None, [_P, _P]),
    "rtcSetGeometryInstancedScene": (None, [_P, _P]),
    "rtcSetSharedGeometryBuffer": (None, [_P, ctypes.c_int, _U, ctypes.c_int, _P, _Z, _Z, _Z]),
}
for _name, (_result, _arguments) in _SIGNATURES.items():
    _function = getattr(library, _name)
    _function.restype, _function.argtypes = _result, _arguments

_device: int | None = None
_device_lock = threading.Lock()


class BuildStopped(Exception):
    """`halt` was set while Embree was building."""


def device() -> int:
    """The one Embree device of this process.

    All its build threads are "user threads": Embree starts none of its own, and a scene is built by those that join.
    So each render keeps to its own number. Embree's `threads` would be the largest of all devices that there are, and
    hold for all in this process that has its tasks done by the same library.
    """
    global _device
    with _device_lock:
        if _device is None:
            _device = library.rtcNewDevice(f"user_threads={usable_processors()}".encode())
        if not _device:
            raise LobeError("Embree could not start on this processor")
        return _device


def _check(what: str) -> None:
    code = library.rtcGetDeviceError(device())
    if code == 4:
        raise LobeError(f"not enough memory to {what}: {ADVICE}")
    if code == 6:
        raise BuildStopped
    if code:
        raise LobeError(f"Embree failed to {what} (error {code})")


@dataclass(frozen=True)
class TriangleGeometry:
    """vertices (V, 3) float32 with room for 16 bytes past the last one used; triangles (T, 3) uint32.

    is_lamp: rays note it and go on
    """

    vertices: np.ndarray
    triangles: np.ndarray
    mask: int
    is_lamp: bool = False


@dataclass(frozen=True)
class SphereGeometry:
    """Lamps. centers_radii (S, 4) float32."""

    centers_radii: np.ndarray
    mask: int
    is_lamp: bool = True


@dataclass(frozen=True)
class InstanceGeometry:
    """One mesh placed many times. transforms (I, 3, 4) float32, object to world."""

    mesh: TriangleGeometry
    transforms: np.ndarray
    mask: int
    is_lamp: bool = False


EmbreeGeometry = TriangleGeometry | SphereGeometry | InstanceGeometry


def _primitives(geometry: EmbreeGeometry) -> int:
    match geometry:
        case TriangleGeometry():
            return len(geometry.triangles)
        case SphereGeometry():
            return len(geometry.centers_radii)
        case InstanceGeometry():
            return len(geometry.transforms)


def _join(scene: int) -> None:
    """Build it together with the other threads that call this, until it is done. Each learns of its errors itself."""
    library.rtcJoinCommitScene(scene)
    _check("build the ray tracing structure")


class Accel:
    """An Embree scene with these geometries, whose ids are their places in the list.

    halt     (1,) uint8; once another thread sets it the build ends, and BuildStopped is raised
    threads  build it, this one among them; not more than there are processors
    """

    def __init__(self, geometries: Sequence[EmbreeGeometry], halt: np.ndarray | None = None, threads: int = 1):
        self._keep: list = []
        self._scenes: list[int] = []
        self._scene_of_mesh: dict[int, int] = {}  # by id(), of meshes that `geometries` holds
        self._halt, self._threads = halt, min(threads, usable_processors())
        try:
            triangles = sum(len(g.triangles) for g in geometries if isinstance(g, TriangleGeometry))
            self.address = self._new_scene(triangles)
            for geometry in geometries:
                self._attach(self.address, self._make(geometry), geometry.mask, geometry.is_lamp)
            self._commit(self.address, sum(map(_primitives, geometries)))
        except BaseException:
            self.release()
            raise

    def _new_scene(self, triangles: int) -> int:
        scene = library.rtcNewScene(device())
        self._scenes.append(scene)
        library.rtcSetSceneBuildQuality(scene, _BUILD_QUALITY_MEDIUM)
        leaves = _SCENE_FLAG_COMPACT if triangles > _MOST_IN_FULL else 0
        library.rtcSetSceneFlags(scene, _SCENE_FLAG_ROBUST | leaves)
        return scene

    def _attach(self, scene: int, geometry: int, mask: int, is_lamp: bool = False) -> None:
        library.rtcSetGeometryMask(geometry, mask)
        if is_lamp:
            library.rtcSetGeometryIntersectFilterFunction(geometry, lamp_filter().address)
        library.rtcCommitGeometry(geometry)
        library.rtcAttachGeometry(scene, geometry)
        library.rtcReleaseGeometry(geometry)
        _check("set up a geometry")

    def _commit(self, scene: int, primitives: int) -> None:
        if self._halt is not None:
            self._keep.append(self._halt)
            library.rtcSetSceneProgressMonitorFunction(scene, build_monitor().address, self._halt.ctypes.data)
        threads = min(self._threads, 1 + primitives // PRIMITIVES_PER_THREAD)
        if threads == 1:
            _join(scene)
            return
        with ThreadPoolExecutor(threads - 1, thread_name_prefix="Lobe build") as pool:
            others = [pool.submit(_join, scene) for _ in range(threads - 1)]
            _join(scene)
            for other in others:
                other.result()

    def _make(self, geometry) -> int:
        match geometry:
            case TriangleGeometry():
                return self._triangle_geometry(geometry)
            case SphereGeometry():
                return self._sphere_geometry(geometry)
            case InstanceGeometry():
                return self._instance_geometry(geometry)
        raise TypeError(f"unknown geometry {geometry!r}")

    def _share(self, geometry: int, buffer: int, layout: int, array: np.ndarray) -> None:
        assert array.flags.c_contiguous, "Embree reads items that lie one after the other"
        self._keep.append(array)
        library.rtcSetSharedGeometryBuffer(
            geometry, buffer, 0, layout, array.ctypes.data, 0, array.strides[0], len(array)
        )

    def _triangle_geometry(self, g: TriangleGeometry) -> int:
        geometry = library.rtcNewGeometry(device(), _TRIANGLE)
        self._share(geometry, _VERTEX, _FLOAT3, g.vertices)
        self._share(geometry, _INDEX, _UINT3, g.triangles)
        return geometry

    def _sphere_geometry(self, g: SphereGeometry) -> int:
        geometry = library.rtcNewGeometry(device(), _SPHERE_POINT)
        self._share(geometry, _VERTEX, _FLOAT4, g.centers_radii)
        return geometry

    def _instance_geometry(self, g: InstanceGeometry) -> int:
        scene = self._mesh_scene(g.mesh)
        geometry = library.rtcNewGeometry(device(), _INSTANCE_ARRAY)
        library.rtcSetGeometryInstancedScene(geometry, scene)
        self._share(geometry, _TRANSFORM, _FLOAT3X4_ROW_MAJOR, g.transforms)
        return geometry

    def _mesh_scene(self, mesh: TriangleGeometry) -> int:
        """Built once for a mesh, however many geometries place it."""
        if id(mesh) not in self._scene_of_mesh:
            scene = self._new_scene(len(mesh.triangles))
            self._attach(scene, self._triangle_geometry(mesh), 0xFFFFFFFF)
            self._commit(scene, len(mesh.triangles))
            self._scene_of_mesh[id(mesh)] = scene
        return self._scene_of_mesh[id(mesh)]

    def release(self) -> None:
        """Give the memory back. The address is invalid from then on."""
        for scene in self._scenes:
            library.rtcReleaseScene(scene)
        self._scenes.clear()
        self._keep.clear()

    def __del__(self):
        self.release()
