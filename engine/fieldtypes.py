"""Whether the fields of a dataclass hold what they are declared to hold: the first half of the border.

Declarations are strings (every module imports annotations from the future), and each has its line in `_DECLARED`. After
these checks `engine.validate` and `Settings.validate` may compare and calculate without a thought for strings, None or
lists in the place of numbers.
"""

from __future__ import annotations

import reprlib
from collections.abc import Callable, Sequence
from dataclasses import fields
from functools import cache, partial
from itertools import chain
from operator import attrgetter
from typing import Any

import numpy as np

# Of whole numbers: numpy has no larger ones.
_LEAST, _MOST = -(1 << 63), (1 << 63) - 1
_ALL_RAYS = 15  # engine.scene.Visibility.ALL


def check_fields(record, fail: Callable[[str], Exception]) -> None:
    """Raises what `fail` makes of the message about the first field of a dataclass that is not as declared."""
    kind: Any = type(record)
    for name, wanted, is_right in _checks(kind):
        value = getattr(record, name)
        if not is_right(value):
            raise fail(f"{name} is {_shown(value)}, it must be {wanted}")


def check_all(records: Sequence, fail: Callable[[Any, str], Exception]) -> None:
    """`check_fields` of many dataclasses, in a tenth of the time where all are of everyday types: a scene may have
    100,000 lamps. fail: gets the record too."""
    for kind in set(map(type, records)):
        alike = [record for record in records if type(record) is kind]
        for field in fields(kind):
            if not _is_everyday(str(field.type), list(map(attrgetter(field.name), alike))):
                for record in records:
                    check_fields(record, partial(fail, record))
                return


def _is_everyday(declared: str, values: list) -> bool:
    """Whether all values are of types that say already that they are as declared."""
    types = set(map(type, values))
    if declared in _EVERYDAY:
        return types <= _EVERYDAY[declared]
    if declared == "int":
        return types == {int} and min(values) >= _LEAST and max(values) <= _MOST
    if declared == "RGB":
        triples = types == {tuple} and set(map(len, values)) == {3}
        return triples and set(map(type, chain.from_iterable(values))) == {float}
    if declared == "Visibility":
        return {kind.__name__ for kind in types} == {"Visibility"} and all(map(_is_visibility, set(values)))
    return False


@cache
def _checks(kind: type) -> list[tuple[str, str, Callable]]:
    return [(f.name, *_DECLARED[str(f.type)]) for f in fields(kind)]


def _shown(value) -> str:
    if isinstance(value, str | bytes | int | float | complex | tuple | None):
        return reprlib.repr(value)
    return f"a {type(value).__name__}"


def _is_number(value) -> bool:
    if isinstance(value, int):
        return _LEAST <= value <= _MOST
    return isinstance(value, float | np.floating | np.integer)


def _is_int(value) -> bool:
    """Python's own, and no bool: for any other type Numba would compile the kernels anew."""
    return type(value) is int and _LEAST <= value <= _MOST


def _is_flag(value) -> bool:
    return isinstance(value, bool | np.bool_)


def _is_array(value) -> bool:
    """No subclass: they change what indexing and sums mean. A masked array would hide indices from their check."""
    return type(value) is np.ndarray


def _is_visibility(value) -> bool:
    return isinstance(value, int | np.integer) and 0 <= int(value) <= _ALL_RAYS


def _are_numbers(count: int) -> Callable:
    def check(value) -> bool:
        if isinstance(value, np.ndarray):
            return _is_array(value) and value.shape == (count,) and value.dtype.kind in "fiu"
        return isinstance(value, tuple | list) and len(value) == count and all(map(_is_number, value))

    return check


def _are_ints(count: int) -> Callable:
    return lambda value: isinstance(value, tuple | list) and len(value) == count and all(map(_is_int, value))


def _is_a(name: str) -> Callable:
    """By name, of the class or one that it comes from: the scene's classes are declared in a module that uses this."""
    return lambda value: any(base.__name__ == name for base in type(value).__mro__)


def _or_none(check: Callable) -> Callable:
    return lambda value: value is None or check(value)


def _list_of(check: Callable) -> Callable:
    """check: says the same of all that are of one type."""
    return lambda value: isinstance(value, list | tuple) and all(map(check, {type(v): v for v in value}.values()))


def _is_text(value) -> bool:
    return isinstance(value, str)


_DECLARED: dict[str, tuple[str, Callable]] = {
    "str": ("text", _is_text),
    "bool": ("True or False", _is_flag),
    "int": ("a whole number", _is_int),
    "float": ("a number", _is_number),
    "RGB": ("three numbers", _are_numbers(3)),
    "Visibility": ("a Visibility", _is_visibility),
    "tuple[float, float, float, float]": ("four numbers", _are_numbers(4)),
    "tuple[int, int, int, int] | None": ("four whole numbers", _or_none(_are_ints(4))),
    "np.ndarray": ("a numpy array", _is_array),
    "np.ndarray | None": ("a numpy array", _or_none(_is_array)),
    "Camera | None": ("a Camera", _or_none(_is_a("Camera"))),
    "Aperture | None": ("an Aperture", _or_none(_is_a("Aperture"))),
    "World": ("a World", _is_a("World")),
    "Mist": ("a Mist", _is_a("Mist")),
    "Instances": ("Instances", _is_a("Instances")),
    "list[Mesh]": ("a list of Meshes", _list_of(_is_a("Mesh"))),
    "list[Material]": ("a list of Materials", _list_of(_is_a("Material"))),
    "list[Lamp]": ("a list of lamps", _list_of(_is_a("Lamp"))),
    "list[str]": ("a list of texts", _list_of(_is_text)),
    "tuple[str, ...]": ("a tuple of texts", lambda value: isinstance(value, tuple) and all(map(_is_text, value))),
}
_EVERYDAY: dict[str, set[type]] = {
    "str": {str},
    "bool": {bool},
    "float": {float},
    "np.ndarray": {np.ndarray},
    "np.ndarray | None": {np.ndarray, type(None)},
}
