"""Embree as seen from kernels: the library, its entry points, and the ray that kernels hand over.

The library is the one that the `embreex` wheel carries. Building scenes is `engine/accel.py`'s business; here are
only the calls that trace rays, one or a packet of them, the memory that they read and write, and what Embree calls
back.

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
# Rays in a packet -> RTC_DEVICE_PROPERTY_NATIVE_RAY*_SUPPORTED of Embree's rtcore_device.h.
_NATIVE = {16: 34, 8: 33, 4: 32}


def _packet_width() -> int:
    """Of the widest packets that Embree has code for on this processor: wider ones it takes apart."""
    new, ask, release = library.rtcNewDevice, library.rtcGetDeviceProperty, library.rtcReleaseDevice
    new.restype, new.argtypes = ctypes.c_void_p, [ctypes.c_char_p]
    ask.restype, ask.argtypes = ctypes.c_ssize_t, [ctypes.c_void_p, ctypes.c_int]
    release.restype, release.argtypes = None, [ctypes.c_void_p]
    device = new(None)
    width = next((width for width, number in _NATIVE.items() if ask(device, number)), 4)
    release(device)
    return width


PACKET_WIDTH = _packet_width()
INTERSECT_PACKET, OCCLUDED_PACKET = f"rtcIntersect{PACKET_WIDTH}", f"rtcOccluded{PACKET_WIDTH}"
for _name in ("rtcIntersect1", "rtcOccluded1", INTERSECT_PACKET, OCCLUDED_PACKET):
    llvm.add_symbol(_name, ctypes.cast(getattr(library, _name), ctypes.c_void_p).value)

_rtcIntersect1 = types.ExternalFunction("rtcIntersect1", types.void(types.voidptr, types.voidptr, types.voidptr))
_rtcOccluded1 = types.ExternalFunction("rtcOccluded1", types.void(types.voidptr, types.voidptr, types.voidptr))
_FOUR_POINTERS = types.void(types.voidptr, types.voidptr, types.voidptr, types.voidptr)
_rtcIntersectPacket = types.ExternalFunction(INTERSECT_PACKET, _FOUR_POINTERS)
_rtcOccludedPacket = types.ExternalFunction(OCCLUDED_PACKET, _FOUR_POINTERS)

# RTCRayHit as float32 words (origin, tnear, direction, time, tfar, then as uint32 mask, id and flags; the hit).
ORIGIN, TNEAR, AIM, TIME, TFAR, MASK, ID, FLAGS = 0, 3, 4, 7, 8, 9, 10, 11
NORMAL, U, V, PRIM_ID, GEOM_ID, INST_ID, INST_PRIM_ID, RAY_ROWS = 12, 15, 16, 17, 18, 19, 20, 21
# A packet, RTCRayHit4, 8 or 16, has a row of so many for each of those words, and behind them one for what marks the
# rays that count.
VALID, PACKET_ROWS = 22, 24
# Behind a single ray first the RTCIntersectArguments: flags, features, the context's address as two words, two
# callbacks and a float. Then the RTCRayQueryContext: two words, and what callers add: the room for lamps that a ray
# passes, and for each ray of a packet how many it has passed, and the lamps.
_ARGUMENTS, _FEATURES, _CONTEXT_ADDRESS, _CONTEXT, _LAMP_ROOM, LAMP_COUNT = 24, 25, 26, 34, 36, 37
_ALIKE = np.uint32(1 << 16)  # RTC_RAY_QUERY_FLAG_COHERENT
# Words of a lamp that was noted. LEAVES is 1 where the ray goes out of a sphere, else 0.
NOTED_GEOM, NOTED_PRIM, NOTED_T, NOTED_LEAVES, NOTED_WORDS = 0, 1, 2, 3, 4
NOTES_OF_A_LAMP = 2  # at most: the two ends of a sphere, the two triangles of a quad
_ALL_FEATURES = 0xFFFFFFFF
INVALID = np.uint32(0xFFFFFFFF)
_EXPONENT_BITS = np.int32(0x7F800000)
_MANY = 1 << 30  # of an array that is handed over without its size


def ray_words(lamp_count: int, rays: int = 1) -> int:
    """The size of the memory for one ray, in a scene where so many rays at a time may meet so many lamps."""
    return LAMP_COUNT + rays * (1 + NOTES_OF_A_LAMP * lamp_count * NOTED_WORDS)


def init_ray(ray: np.ndarray, lamp_count: int) -> None:
    """Set up that memory: float32, zero, aligned to 16 bytes as Embree demands. From now on it stays where it is."""
    bits = ray.view(np.uint32)
    bits[_FEATURES] = _ALL_FEATURES
    bits[_CONTEXT : _CONTEXT + 2] = INVALID
    bits[_CONTEXT_ADDRESS : _CONTEXT_ADDRESS + 2].view(np.uint64)[0] = ray.ctypes.data + 4 * _CONTEXT
    bits[_LAMP_ROOM] = NOTES_OF_A_LAMP * lamp_count


def aligned_memory(size: int) -> np.ndarray:
    """(size,) float32 zeros, aligned to the 64 bytes that vectors are loaded by."""
    raw = np.zeros(size + 16, np.float32)
    start = (-raw.ctypes.data) % 64 // 4
    return raw[start : start + size]


def new_ray(lamp_count: int = 0) -> np.ndarray:
    """Memory for one thread's rays, one at a time, in a scene where they may meet so many lamps."""
    ray = aligned_memory(ray_words(lamp_count))
    init_ray(ray, lamp_count)
    return ray


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
    ray[ORIGIN] = origin[0]
    ray[ORIGIN + 1] = origin[1]
    ray[ORIGIN + 2] = origin[2]
    ray[TNEAR] = t_near
    ray[AIM] = direction[0]
    ray[AIM + 1] = direction[1]
    ray[AIM + 2] = direction[2]
    ray[TIME] = np.float32(0)
    ray[TFAR] = t_far
    words[MASK] = mask
    words[ID] = np.uint32(0)
    words[FLAGS] = np.uint32(0)


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
def _note_lamp(notes, room, ray, hit, n, lane):
    """Write down that ray `lane` of n passes a lamp. notes: of all rays, from the first one's count on."""
    own = np.int64(bits_of(ray[ID * n + lane])) * (1 + np.int64(room) * NOTED_WORDS)
    count = notes[own]
    if count >= room:
        return
    place = own + 1 + np.int64(count) * NOTED_WORDS
    notes[place + NOTED_GEOM] = np.uint32(bits_of(hit[(GEOM_ID - NORMAL) * n + lane]))
    notes[place + NOTED_PRIM] = np.uint32(bits_of(hit[(PRIM_ID - NORMAL) * n + lane]))
    notes[place + NOTED_T] = np.uint32(bits_of(ray[TFAR * n + lane]))
    outwards = np.float32(0)
    for k in range(3):
        outwards += ray[(AIM + k) * n + lane] * hit[k * n + lane]
    notes[place + NOTED_LEAVES] = np.uint32(outwards > np.float32(0))
    notes[own] = count + np.uint32(1)


@device
def note_words(ray):
    """How many words lie between the LAMP_COUNT of one ray and that of the next."""
    return 1 + np.int64(ray.words[_LAMP_ROOM]) * NOTED_WORDS


@cache
def lamp_filter():
    """What Embree asks about each lamp that rays meet: an RTCFilterFunctionN that lets no ray end."""

    @callback("void(voidptr)")
    def note(pointer):
        arguments = carray(pointer, 6, np.uintp)  # valid, user pointer, context, rays, hits, how many
        n = np.int64(np.uint32(arguments[5]))
        valid, room = carray(_pointer(arguments[0]), n, np.int32), carray(_pointer(arguments[2]), 3, np.uint32)[2]
        notes = carray(_pointer(arguments[2] + np.uintp(4 * (LAMP_COUNT - _CONTEXT))), _MANY, np.uint32)
        rays = carray(_pointer(arguments[3]), _MANY, np.float32)
        hits = carray(_pointer(arguments[4]), _MANY, np.float32)
        for lane in range(n):
            if valid[lane]:
                valid[lane] = 0
                _note_lamp(notes, room, rays, hits, n, lane)

    return note


@device
def intersect_packets(scene, packets, ray, alike):
    """Find the closest hits of the rays in `packets` that are marked in VALID, and note lamps in `ray`, a
    `RayMemory`. packets: (any number, PACKET_ROWS, PACKET_WIDTH) uint32. alike: the rays start and go alike, for which
    Embree has other code (a trial in benchmarks/trials.py has what it brings); then a ray's neighbours in the packet
    decide which of two surfaces it meets that lie in the same place."""
    ray.words[_ARGUMENTS] = _ALIKE if alike else np.uint32(0)
    arguments, row = np.uintp(ray.words.ctypes.data + 4 * _ARGUMENTS), 4 * PACKET_WIDTH
    for i in range(packets.shape[0]):
        rays = np.uintp(packets.ctypes.data + i * PACKET_ROWS * row)
        valid = np.uintp(rays + np.uintp(VALID * row))
        _rtcIntersectPacket(_pointer(valid), _pointer(scene), _pointer(rays), _pointer(arguments))


@device
def occluded_packets(scene, packets, ray, alike):
    """As `intersect_packets`: of blocked rays TFAR is then below 0. alike: they start and go alike."""
    ray.words[_ARGUMENTS] = _ALIKE if alike else np.uint32(0)
    arguments, row = np.uintp(ray.words.ctypes.data + 4 * _ARGUMENTS), 4 * PACKET_WIDTH
    for i in range(packets.shape[0]):
        rays = np.uintp(packets.ctypes.data + i * PACKET_ROWS * row)
        valid = np.uintp(rays + np.uintp(VALID * row))
        _rtcOccludedPacket(_pointer(valid), _pointer(scene), _pointer(rays), _pointer(arguments))


@device
def intersect_one_by_one(scene, packets, ray):
    """As `intersect_packets`, by single rays."""
    ray.words[_ARGUMENTS] = np.uint32(0)
    address = np.uintp(ray.words.ctypes.data)
    for i in range(packets.shape[0]):
        for lane in range(packets.shape[2]):
            if packets[i, VALID, lane]:
                for row in range(RAY_ROWS):
                    ray.words[row] = packets[i, row, lane]
                arguments = np.uintp(address + np.uintp(4 * _ARGUMENTS))
                _rtcIntersect1(_pointer(scene), _pointer(address), _pointer(arguments))
                for row in range(TFAR, RAY_ROWS):
                    packets[i, row, lane] = ray.words[row]


@device
def occluded_one_by_one(scene, packets, ray):
    """As `occluded_packets`, by single rays."""
    address = np.uintp(ray.words.ctypes.data)
    for i in range(packets.shape[0]):
        for lane in range(packets.shape[2]):
            if packets[i, VALID, lane]:
                for row in range(NORMAL):
                    ray.words[row] = packets[i, row, lane]
                _rtcOccluded1(_pointer(scene), _pointer(address), _pointer(np.uintp(0)))
                packets[i, TFAR, lane] = ray.words[TFAR]


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
