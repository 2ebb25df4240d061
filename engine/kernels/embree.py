"""Embree as seen from kernels: the library, its entry points, the ray that kernels hand over, and a float's bits.

The library is the one that the `embreex` wheel carries. Building scenes is `engine/accel.py`'s business; here are
only the two calls that a path makes, the layout of the memory that they read and write, and what Embree calls back.

Lamps are seen but stop no ray. Embree therefore asks `lamp_filter` about each lamp that a ray meets, and that writes
it down and lets the ray go on. So one search finds the next surface and all lamps before it, however they lie.
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
TNEAR, TFAR = 3, 8
NORMAL, U, V, PRIM_ID, GEOM_ID, INST_ID, INST_PRIM_ID = 12, 15, 16, 17, 18, 19, 20
RAY_WORDS = 24
# Behind it, for rays that note lamps, first the RTCIntersectArguments: flags, features, the context's address as two
# words, two callbacks and a float. Then the RTCRayQueryContext: two words, and what callers add: the lamps.
_ARGUMENTS, _FEATURES, _CONTEXT_ADDRESS, _CONTEXT, LAMP_COUNT, _LAMP_ROOM, NOTED_LAMPS = 24, 25, 26, 34, 36, 37, 38
# Words of a lamp that was noted. LEAVES is 1 where the ray goes out of a sphere, else 0.
NOTED_GEOM, NOTED_PRIM, NOTED_T, NOTED_LEAVES, NOTED_WORDS = 0, 1, 2, 3, 4
NOTES_OF_A_LAMP = 2  # at most: the two ends of a sphere, the two triangles of a quad
_ALL_FEATURES = 0xFFFFFFFF
INVALID = np.uint32(0xFFFFFFFF)
_EXPONENT_BITS = np.int32(0x7F800000)


def new_ray(lamp_count: int = 0) -> np.ndarray:
    """Scratch for one thread's rays, in a scene where they may meet so many lamps: float32, aligned to 16 bytes as
    Embree demands."""
    room = NOTES_OF_A_LAMP * lamp_count
    size = NOTED_LAMPS + room * NOTED_WORDS
    raw = np.zeros(size + 4, np.float32)
    start = (-raw.ctypes.data) % 16 // 4
    ray = raw[start : start + size]
    bits = ray.view(np.uint32)
    bits[_FEATURES] = _ALL_FEATURES
    bits[_CONTEXT : _CONTEXT + 2] = INVALID
    bits[_CONTEXT_ADDRESS : _CONTEXT_ADDRESS + 2].view(np.uint64)[0] = ray.ctypes.data + 4 * _CONTEXT
    bits[_LAMP_ROOM] = room
    return ray


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

    scene  address of the Embree scene
    mask   uint32, compared with the masks of geometries. Without lamps: `lamp_filter` would find no place for them
    """
    _set_ray(ray, words, origin, direction, t_near, t_far, mask)
    words[GEOM_ID] = INVALID
    words[INST_ID] = INVALID
    _rtcIntersect1(_pointer(scene), _pointer(np.uintp(ray.ctypes.data)), _pointer(np.uintp(0)))
    return words[GEOM_ID] != INVALID


@device
def intersect_noting_lamps(scene, ray, words, origin, direction, t_near, t_far, mask):
    """As `intersect`, and note the lamps before the hit, in no order, and perhaps some behind it: LAMP_COUNT of them
    from NOTED_LAMPS on."""
    _set_ray(ray, words, origin, direction, t_near, t_far, mask)
    words[GEOM_ID] = INVALID
    words[INST_ID] = INVALID
    words[LAMP_COUNT] = np.uint32(0)
    address = np.uintp(ray.ctypes.data)
    _rtcIntersect1(_pointer(scene), _pointer(address), _pointer(address + np.uintp(4 * _ARGUMENTS)))
    return words[GEOM_ID] != INVALID


@cache
def lamp_filter():
    """What Embree asks about each lamp that a ray meets: an RTCFilterFunctionN, for one ray, that lets no ray end."""

    @callback("void(voidptr)")
    def note(pointer):
        arguments = carray(pointer, 5, np.uintp)  # valid, user pointer, context, ray, hit
        head = carray(_pointer(arguments[2]), NOTED_LAMPS - _CONTEXT, np.uint32)
        count, room = head[LAMP_COUNT - _CONTEXT], head[_LAMP_ROOM - _CONTEXT]
        carray(_pointer(arguments[0]), 1, np.int32)[0] = 0
        if count >= room:
            return
        ray = carray(_pointer(arguments[3]), RAY_WORDS, np.float32)
        normal = carray(_pointer(arguments[4]), 3, np.float32)
        hit = carray(_pointer(arguments[4]), RAY_WORDS - NORMAL, np.uint32)
        offset = np.uintp(4 * (NOTED_LAMPS - _CONTEXT + np.int64(count) * NOTED_WORDS))
        place = carray(_pointer(arguments[2] + offset), NOTED_WORDS, np.uint32)
        place[NOTED_GEOM] = hit[GEOM_ID - NORMAL]
        place[NOTED_PRIM] = hit[PRIM_ID - NORMAL]
        place[NOTED_T] = np.uint32(bits_of(ray[TFAR]))
        outwards = ray[4] * normal[0] + ray[5] * normal[1] + ray[6] * normal[2] > np.float32(0)
        place[NOTED_LEAVES] = np.uint32(outwards)
        head[LAMP_COUNT - _CONTEXT] = count + np.uint32(1)

    return note


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
