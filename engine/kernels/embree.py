"""Embree as seen from kernels: the library, its entry points, and the ray that kernels hand over.

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
from .simd import bits_of


def load_library() -> ctypes.CDLL:
    """The Embree 4 library, through the extension module that links it (on Windows the DLL beside it)."""
    if sys.platform == "win32":
        folder = Path(embreex.rtcore_scene.__file__).parents[1] / "embreex.libs"
        return ctypes.CDLL(str(next(folder.glob("embree4*.dll"))))
    return ctypes.CDLL(embreex.rtcore_scene.__file__)


library = load_library()
for _name in ("rtcIntersect1", "rtcOccluded1", "rtcIntersect16", "rtcOccluded16"):
    llvm.add_symbol(_name, ctypes.cast(getattr(library, _name), ctypes.c_void_p).value)

_rtcIntersect1 = types.ExternalFunction("rtcIntersect1", types.void(types.voidptr, types.voidptr, types.voidptr))
_rtcOccluded1 = types.ExternalFunction("rtcOccluded1", types.void(types.voidptr, types.voidptr, types.voidptr))
_FOUR_POINTERS = types.void(types.voidptr, types.voidptr, types.voidptr, types.voidptr)
_rtcIntersect16 = types.ExternalFunction("rtcIntersect16", _FOUR_POINTERS)
_rtcOccluded16 = types.ExternalFunction("rtcOccluded16", _FOUR_POINTERS)

# RTCRayHit as float32 words (origin, tnear, direction, time, tfar, then as uint32 mask, id and flags; the hit).
TNEAR, TFAR = 3, 8
NORMAL, U, V, PRIM_ID, GEOM_ID, INST_ID, INST_PRIM_ID = 12, 15, 16, 17, 18, 19, 20
RAY_WORDS = 24
# A packet, RTCRayHit16, has a row of sixteen for each of those words. Behind it a row for the mask of the rays that
# count, and one for the RTCIntersectArguments that tell Embree that they start and go alike.
VALID_ROW, ARGUMENTS_ROW, PACKET_ROWS = 22, 23, 24
_COHERENT = 1 << 16  # RTC_RAY_QUERY_FLAG_COHERENT
# Behind a single ray, for rays that note lamps, first the RTCIntersectArguments: flags, features, the context's address
# as two words, two callbacks and a float. Then the RTCRayQueryContext: two words, and what callers add: the lamps.
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


def init_packet(packet: np.ndarray) -> None:
    """What of a packet's memory (PACKET_ROWS, 16), aligned to 64 bytes, stays as it is."""
    arguments = packet[ARGUMENTS_ROW].view(np.uint32)
    arguments[0], arguments[1] = _COHERENT, _ALL_FEATURES


@intrinsic
def _pointer(typing_context, address):
    """An integer address as the pointer type that external functions take."""

    def codegen(context, builder, signature, args):
        return builder.inttoptr(args[0], cgutils.voidptr_t)

    return types.voidptr(types.uintp), codegen


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
def intersect_packet(scene, packet, words, coherent):
    """As `intersect`, for the rays of a packet that are marked in VALID_ROW. The caller has set all other rows."""
    address = np.uintp(packet.ctypes.data)
    valid, arguments = np.uintp(address + np.uintp(64 * VALID_ROW)), np.uintp(address + np.uintp(64 * ARGUMENTS_ROW))
    _rtcIntersect16(
        _pointer(valid), _pointer(scene), _pointer(address), _pointer(arguments if coherent else np.uintp(0))
    )


@device
def occluded_packet(scene, packet, words, coherent):
    """As `occluded`: of rays that something blocks, TFAR is then below 0."""
    address = np.uintp(packet.ctypes.data)
    valid, arguments = np.uintp(address + np.uintp(64 * VALID_ROW)), np.uintp(address + np.uintp(64 * ARGUMENTS_ROW))
    _rtcOccluded16(
        _pointer(valid), _pointer(scene), _pointer(address), _pointer(arguments if coherent else np.uintp(0))
    )


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
