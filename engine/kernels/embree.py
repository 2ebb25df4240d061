"""Embree as seen from kernels: the library, its entry points, the ray that kernels hand over, and a float's bits.

The library is the one that the `embreex` wheel carries. Building scenes is `engine/accel.py`'s business; here are
only the two calls that a path makes, and the layout of the 96 bytes that they read and write.
"""

from __future__ import annotations

import ctypes
import sys
from functools import cache
from pathlib import Path

import embreex.rtcore_scene
import llvmlite.binding as llvm
import numpy as np
from numba import carray, types
from numba.core import cgutils
from numba.extending import intrinsic

from .jit import callback, device


def load_library() -> ctypes.CDLL:
    """The Embree 4 library, through the extension module that links it (on Windows the DLL beside it)."""
    if sys.platform == "win32":
        folder = Path(embreex.rtcore_scene.__file__).parents[1] / "embreex.libs"
        return ctypes.CDLL(str(next(folder.glob("embree4*.dll"))))
    return ctypes.CDLL(embreex.rtcore_scene.__file__)


library = load_library()
for _name in ("rtcIntersect1", "rtcOccluded1"):
    llvm.add_symbol(_name, ctypes.cast(getattr(library, _name), ctypes.c_void_p).value)

_rtcIntersect1 = types.ExternalFunction("rtcIntersect1", types.void(types.voidptr, types.voidptr, types.voidptr))
_rtcOccluded1 = types.ExternalFunction("rtcOccluded1", types.void(types.voidptr, types.voidptr, types.voidptr))

# RTCRayHit as float32 words (origin, tnear, direction, time, tfar, then as uint32 mask, id and flags; the hit).
TFAR = 8
NORMAL, U, V, PRIM_ID, GEOM_ID, INST_ID, INST_PRIM_ID = 12, 15, 16, 17, 18, 19, 20
RAY_WORDS = 24
INVALID = np.uint32(0xFFFFFFFF)
_EXPONENT_BITS = np.int32(0x7F800000)


def new_ray() -> np.ndarray:
    """Scratch for one thread's rays: (24,) float32, aligned to 16 bytes as Embree demands."""
    raw = np.zeros(RAY_WORDS + 4, np.float32)
    start = (-raw.ctypes.data) % 16 // 4
    return raw[start : start + RAY_WORDS]


@intrinsic
def _pointer(typing_context, address):
    """An integer address as the pointer type that external functions take."""

    def codegen(context, builder, signature, args):
        return builder.inttoptr(args[0], cgutils.voidptr_t)

    return types.voidptr(types.uintp), codegen


@intrinsic
def bits_of(typing_context, value):
    """The bits of a float32 as an int32."""

    def codegen(context, builder, signature, args):
        return builder.bitcast(args[0], context.get_value_type(types.int32))

    return types.int32(types.float32), codegen


@intrinsic
def float_of(typing_context, value):
    """The float32 that has these int32 bits."""

    def codegen(context, builder, signature, args):
        return builder.bitcast(args[0], context.get_value_type(types.float32))

    return types.float32(types.int32), codegen


@device
def is_finite(value):
    """By its bits: fastmath folds `isfinite`, which is x - x == 0, to True."""
    return (bits_of(value) & _EXPONENT_BITS) != _EXPONENT_BITS


@device
def _set_ray(ray, words, origin, direction, t_near, t_far, mask):
    ray[0] = origin[0]
    ray[1] = origin[1]
    ray[2] = origin[2]
    ray[3] = t_near
    ray[4] = direction[0]
    ray[5] = direction[1]
    ray[6] = direction[2]
    ray[7] = np.float32(0)
    ray[8] = t_far
    words[9] = mask
    words[10] = np.uint32(0)
    words[11] = np.uint32(0)


@device
def intersect(scene, ray, words, origin, direction, t_near, t_far, mask):
    """Find the closest hit; True if there is one. The hit is then in `ray` and `words` (its uint32 view).

    scene  address of the Embree scene;  mask  uint32, compared with the masks of geometries
    """
    _set_ray(ray, words, origin, direction, t_near, t_far, mask)
    words[GEOM_ID] = INVALID
    words[INST_ID] = INVALID
    _rtcIntersect1(_pointer(scene), _pointer(np.uintp(ray.ctypes.data)), _pointer(np.uintp(0)))
    return words[GEOM_ID] != INVALID


@device
def occluded(scene, ray, words, origin, direction, t_near, t_far, mask):
    """True if anything lies on the segment from t_near to t_far."""
    _set_ray(ray, words, origin, direction, t_near, t_far, mask)
    _rtcOccluded1(_pointer(scene), _pointer(np.uintp(ray.ctypes.data)), _pointer(np.uintp(0)))
    return ray[TFAR] < np.float32(0)


@cache
def build_monitor():
    """What Embree asks, thousands of times and on its own threads, whether to go on building: until the byte that it
    is given is set."""

    @callback("uint8(voidptr, float64)")
    def goes_on(halt, _fraction):
        return np.uint8(carray(halt, 1, np.uint8)[0] == 0)

    return goes_on
