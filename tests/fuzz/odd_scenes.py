"""Scenes with something wrong in them, each made from its number alone, and the judgement of what came of them.

A case takes a small scene that has everything, or settings, puts one to three odd values into fields or arrays found
by walking the dataclasses (so new fields are fuzzed without anybody's doing), and renders. It may give a picture, or a
SceneError or SettingsError that names the object at fault; anything else is a finding. `tools/fuzz.py` runs cases by
the thousand in processes of their own.
"""

from __future__ import annotations

import random
import re
import traceback
from collections.abc import Callable, Iterator
from contextlib import nullcontext
from dataclasses import dataclass, fields, is_dataclass
from decimal import Decimal
from fractions import Fraction
from time import perf_counter, process_time
from unittest import mock

import numpy as np
import scenes

import engine
import engine.pack.geometry as packing
from engine import Aperture, Instances, LobeError, Material, Mesh, Scene, Settings, Visibility, World
from tools.forcing import everything_on

SECONDS = 0.3  # after them a render has to end: odd resolutions and counts may be valid and large
# What is asked of a picture holds below this; above, sums of valid energies overflow, which the render report says.
BRIGHT = 1e15

NUMBERS = (
    float("nan"), float("inf"), float("-inf"), -1.0, 0.0, -0.0, 1e-45, 1e-30, 1e-10, 0.5, 1.5, 7.3, 1e5, 1e10, 1e19,
    1e30, 3e38, 1e39, 1e300, -1e300, 1e308, 1, 3, -7, 255, 65536, 2**24, 2**31 - 1, 2**31, 2**32, 2**63, 2**64,
    -(2**31) - 1, 10**400, True, False, np.float32(0.25), np.float16("nan"), np.float64(-2), np.int8(-3),
    np.uint64(2**64 - 1), Fraction(1, 3), Fraction(-7, 2),
)  # fmt: skip
THINGS = (
    None, "", "1", "a name", b"bytes", [], (), {}, {"a": 1}, object(), object, 1j, Decimal("0.5"), np.array(1.0),
    np.array([1.0]), np.zeros(0), np.zeros((2, 2)), np.str_("a"), np.datetime64("NaT"), (0.1, 0.2), (0.1, 0.2, 0.3),
    (0.1, 0.2, 0.3, 0.4), [0.5, 0.5, 0.5], ("1", "1", "1"), (None,) * 3, (1j, 0, 0), ((1, 2), (3,)), range(3), len,
    (float("nan"), 0.0, 0.0), (float("inf"), 1.0, 1.0), (-1.0, 1.0, 1.0), (1e30, 1e30, 1e30), np.full(3, 0.5),
    (0, 0, 4, 4), (0, 0, -4, 4), (0.0, 0.0, 2.5, 2.5), (-1, -1, 2, 2), (True, True, True), Visibility(0),
    Visibility.CAMERA, Material("a stray"), World(), Scene(), Settings(), Mesh("bare", None, None), Instances(),
)  # fmt: skip
DTYPES = ("<f2", "<f4", "<f8", ">f4", ">f8", "?", "<i1", "<i4", "<i8", "<u1", "<u4", "<u8", ">u4", "<c8", "O", "U8",
          "S4", "M8[s]", "i4,f4")  # fmt: skip
NAMES = (None, "", 7, "\0", "a" * 10000, "ü", b"x", ["x"])


@dataclass
class Place:
    """A field that a case may spoil, and what a message about it must match."""

    holder: object
    field: str
    named: str

    def get(self):
        return getattr(self.holder, self.field)

    def put(self, value) -> None:
        object.__setattr__(self.holder, self.field, value)


def base(rng: random.Random) -> Scene:
    """A tiny scene with something of everything."""
    scene = Scene(width=6, height=5, camera=scenes.camera(origin=(0, -4, 2.2), towards=(0, 4, -1.6)))
    object.__setattr__(scene.camera, "aperture", Aperture(0.01, 4.0, blades=5))
    scene.materials = [
        Material("floor", kd=(0.5, 0.45, 0.4), ks=(0.3,) * 3, exponent=30.0),
        Material("glow", emission=(1.0, 2.0, 3.0)),
        Material("film", kd=(0.2,) * 3, transparency=(0.5, 0.3, 0.0)),
    ]
    ball = scenes.sphere_mesh(3, 0.5, smooth=True, name="ball")
    block = scenes.cube_mesh(0.3, "block")
    block.normals = np.array([[0, 0, 1], [0, 1, 0], [1, 0, 0]], np.float32)
    block.normal_indices = (np.arange(36, dtype=np.uint32) % 3).reshape(12, 3)
    block.material_slots = np.arange(12, dtype=np.int32) % 3
    scene.add_instance(scenes.quad_mesh((-4, -4, 0), (8, 0, 0), (0, 8, 0), "floor"))
    scene.add_instance(scenes.quad_mesh((-1, 1, 1), (1, 0, 0), (0, 0, 1), "glow"), materials=(1,))
    for x in (-0.8, 0.8):
        scene.add_instance(ball, scenes.place((x, 0, 0.5)), materials=(0,), name=f"ball at {x}")
    seen = Visibility.ALL & ~rng.choice((Visibility(0), Visibility.SHADOW))
    scene.add_instance(block, scenes.place((0, -0.5, 0.5)), materials=(2, 0), visibility=seen, name="block")
    scene.lights = [scenes.lamp(kind) for kind in rng.sample(scenes.LAMP_KINDS, rng.randint(0, 4))]
    image = scenes.sky_image(2, 4) if rng.random() < 0.5 else None
    scene.world = World(color=(0.1, 0.1, 0.1), image=image)
    return scene


def places(scene: Scene) -> list[Place]:
    """Every field of everything in the scene."""
    size = "resolution|region|pixels|width|height"
    of_scene = {"width": size, "height": size, "meshes": "mesh|object"}
    of_scene |= {"materials": "material", "lights": "light", "instances": "instances"}
    found = [Place(scene, f.name, of_scene.get(f.name, f.name.split("_")[-1])) for f in fields(scene)]
    found += _fields(scene.camera, "the camera") + _fields(scene.camera.aperture, "the camera")
    found += _fields(scene.world, "the world") + _fields(scene.instances, "instance|object")
    for mesh in scene.meshes:
        found += _fields(mesh, f"{re.escape(repr(mesh.name))}|object '")
    for kind, records in (("material", scene.materials), ("light", scene.lights)):
        for record in records:
            found += _fields(record, f"{kind} {re.escape(repr(record.name))}|object '")
    return found


def _fields(record, named: str) -> list[Place]:
    # A spoilt name is what the message has to go by.
    return [Place(record, f.name, "" if f.name == "name" else named) for f in fields(record)]


# --- odd values ----------------------------------------------------------------------------------------------------


def odd_value(rng: random.Random, old):
    """Something else than `old`: for an array mostly another array, for a list mostly an odd list."""
    chance = rng.random()
    if isinstance(old, np.ndarray) and chance < 0.95 and old.size < 2**20:
        return rng.choice(ARRAY_CHANGES)(rng, old)
    if isinstance(old, list | tuple) and old and chance < 0.8:
        return odd_list(rng, old)
    if isinstance(old, str):
        return rng.choice(NAMES)
    if isinstance(old, bool | Visibility) and chance < 0.7:
        return type(old)(rng.randrange(2 if isinstance(old, bool) else 16))
    if type(old) in (int, float, bool) and chance < 0.8:
        return rng.choice([x for x in NUMBERS if type(x) is type(old)])
    return rng.choice(NUMBERS + THINGS)


def odd_list(rng: random.Random, old):
    items = list(old)
    change = rng.choice((0, 1, 2, 3, 4, 4, 4, 4, 4))
    if change == 0:
        items[rng.randrange(len(items))] = rng.choice(THINGS)
    elif change == 1:
        items.pop(rng.randrange(len(items)))
    elif change == 2:
        items += items
    elif change == 3:
        items.clear()
    else:
        place = rng.randrange(len(items))
        numbers = [x for x in NUMBERS if type(x) is type(items[place])]
        items[place] = rng.choice(numbers) if numbers else rng.choice(items)
    return type(old)(items) if rng.random() < 0.9 else (tuple(items) if isinstance(old, list) else items)


def _with_odd_elements(rng: random.Random, old: np.ndarray):
    """NaN, infinities, huge numbers, and indices off by one or by far."""
    array = old.copy()
    if not array.size:
        return array
    rows = len(np.atleast_1d(array))
    values: list = [0, 1, 2, rows, rows - 1]
    if array.dtype.kind == "f":
        values = [v for v in NUMBERS if not isinstance(v, int) or abs(v) < 2**63]
    elif array.dtype.kind in "iu":
        values += [np.iinfo(array.dtype).max, np.iinfo(array.dtype).min, array.max() + 1, 16, 127]
    value = rng.choice(values)
    where = rng.choice(["one", "row", "all", "scaled"])
    with np.errstate(all="ignore"):
        if where == "one":
            array.flat[rng.randrange(array.size)] = value
        elif where == "row":
            np.atleast_1d(array)[rng.randrange(rows)] = value
        elif where == "all":
            array[...] = value
        else:
            array = (array * value).astype(array.dtype)
    return array


def _with_odd_type(rng: random.Random, old: np.ndarray):
    with np.errstate(all="ignore"):
        try:
            return old.astype(rng.choice(DTYPES))
        except (TypeError, ValueError):
            return np.empty(old.shape, rng.choice(DTYPES))


def _with_odd_shape(rng: random.Random, old: np.ndarray):
    shapes: list[Callable] = [
        lambda a: a.ravel(), lambda a: a.T, lambda a: a[None], lambda a: a[..., None], lambda a: a[..., :2],
        lambda a: a[:0], lambda a: a[:1], lambda a: a[:-1], lambda a: a[1:], lambda a: np.concatenate([a, a]),
        lambda a: np.concatenate([a, a], axis=-1), lambda a: np.zeros((), a.dtype), lambda a: np.zeros(0, a.dtype),
        lambda a: a[..., :0], lambda a: np.zeros((0, *a.shape[1:]), a.dtype), lambda a: np.zeros((0, 0), a.dtype),
    ]  # fmt: skip
    return rng.choice(shapes)(old)


def _with_odd_memory(rng: random.Random, old: np.ndarray):
    """The same values, stored in another way: most of these have to render."""
    kept = old.copy()
    kept.flags.writeable = False
    unaligned = np.frombuffer(b"\0" + old.tobytes(), np.uint8)[1:]
    changes: list[Callable] = [
        lambda: np.asfortranarray(old), lambda: old[::-1], lambda: np.repeat(old, 2, axis=0)[::2], lambda: kept,
        lambda: np.concatenate([old, old], axis=-1)[..., : old.shape[-1]], lambda: old.tolist(), lambda: old.data,
        lambda: np.broadcast_to(old[:1], old.shape), lambda: unaligned.view(old.dtype).reshape(old.shape),
        lambda: np.ma.masked_array(old, mask=old == old), lambda: old.view(np.recarray), lambda: old[..., ::-1],
        lambda: np.asmatrix(old) if old.ndim < 3 else old,
    ]  # fmt: skip
    return rng.choice(changes)()


def _huge(rng: random.Random, old: np.ndarray):
    """Counts that no memory holds, by a view that repeats one row."""
    if not len(old):
        return old
    return np.broadcast_to(old[:1], (rng.choice((1000, 2**31, 2**32, 2**40)), *old.shape[1:]))


ARRAY_CHANGES = (
    *[_with_odd_elements] * 8, *[_with_odd_memory] * 4, _with_odd_shape, _with_odd_shape, _with_odd_type, _huge,
)  # fmt: skip


# --- a case --------------------------------------------------------------------------------------------------------


@dataclass
class Verdict:
    """outcome: "picture", "refused", or a finding: "unnamed" (a message without the object), "escaped" (another
    exception), "wrong picture", "slow"."""

    number: int
    outcome: str
    changed: str
    text: str = ""

    @property
    def is_finding(self) -> bool:
        return self.outcome not in ("picture", "refused")


@dataclass
class Case:
    number: int
    scene: Scene
    settings: Settings
    changed: list[str]
    named: list[str]
    bright: bool
    instanced: bool


def make_case(number: int) -> Case:
    """The same number gives the same case."""
    rng = random.Random(number)
    road = "REFERENCE" if rng.random() < 0.05 else "COMPILED"
    settings = Settings(samples=1, max_bounces=2, threads=1, road=road, seed=number, time_limit=SECONDS)
    scene = base(rng)
    case = Case(number, scene, settings, [], [], False, rng.random() < 0.3)
    if rng.random() < 0.1:
        _spoil(rng, case, [Place(settings, f.name, f"setting '?{f.name}\\b") for f in fields(settings)])
    else:
        found = places(scene)
        for _ in range(rng.choice((1, 1, 2, 3))):
            _spoil(rng, case, found)
    return case


def _spoil(rng: random.Random, case: Case, found: list[Place]) -> None:
    place = rng.choice(found)
    value = odd_value(rng, place.get())
    case.changed.append(f"{type(place.holder).__name__}.{place.field} = {_short(value)}")
    case.named.append(place.named)
    case.bright |= _largest(value) > BRIGHT
    place.put(value)


def _short(value) -> str:
    if isinstance(value, np.ndarray):
        small = value.tolist() if value.size < 40 else "..."
        layout = f"strides {value.strides}" + ("" if value.flags.writeable else ", read-only")
        return f"{type(value).__name__} {value.dtype} {value.shape} {layout}: {small}"
    return (f"{type(value).__name__} " + ("" if is_dataclass(value) else repr(value)))[:200]


def _largest(value) -> float:
    """Of the finite magnitudes in it."""
    try:
        array = np.abs(np.asarray(value, np.complex128)) if np.size(value) < 2**20 else np.zeros(1)
    except (TypeError, ValueError, OverflowError):
        return 0.0
    return float(np.max(array, initial=0.0, where=np.isfinite(array)))


def judge(case: Case) -> Verdict:
    changed = "; ".join(case.changed)
    begun, worked = perf_counter(), process_time()
    try:
        with everything_on(), mock.patch.object(packing, "BAKE_LIMIT", 0) if case.instanced else nullcontext():
            result = engine.render(case.scene, case.settings, stop=lambda: perf_counter() > begun + SECONDS)
    except LobeError as error:
        named = any(re.search(pattern, str(error)) for pattern in case.named)
        return Verdict(case.number, "refused" if named else "unnamed", changed, str(error))
    except Exception:
        return Verdict(case.number, "escaped", changed, traceback.format_exc())
    worked = process_time() - worked  # not the clock's: the machine may have other work
    if worked > 4 * SECONDS:
        return Verdict(case.number, "slow", changed, f"{worked:.1f} s, {result.seconds}")
    problem = "" if case.bright else _wrong(result)
    return Verdict(case.number, "wrong picture" if problem else "picture", changed, problem)


def _wrong(result: engine.Result) -> str:
    """What must not be in any picture."""
    color, alpha = result.pixels[..., :3], result.pixels[..., 3]
    if result.rejected:
        return f"{result.rejected} samples were not finite"
    if not np.isfinite(result.pixels).all():
        return "a pixel is not finite"
    if (color < 0).any():
        return f"a pixel is negative: {color.min()}"
    if (alpha < 0).any() or (alpha > 1 + 1e-5).any():
        return f"an alpha is not in 0..1: {alpha.min()} to {alpha.max()}"
    return ""


def cases(first: int, count: int) -> Iterator[Case]:
    return (make_case(number) for number in range(first, first + count))
