"""Sixteen numbers at once: types for Numba that are LLVM's vectors, and what the kernels do with them.

The same function takes scalars and vectors, as `select`, `any_of`, `no`, `at` and the casts take both. What has to be
kept in mind in such a function: `if` and `and` decide for one number only, so a condition on data is a `select`, or an
`any_of` that spares work which no lane needs; and lanes that don't take part calculate too. Their results are thrown
away, but the rows that they look up must exist.
"""

from .arithmetic import (
    any_of,
    bits_of,
    count,
    float32,
    float64,
    float_of,
    floor,
    int32,
    no,
    select,
    spread,
    to_index,
    total,
    uint32,
)
from .memory import (
    add_at,
    at,
    first_lanes,
    lanes,
    load,
    load_parts,
    put_at,
    store,
    store_front,
    store_parts,
    words_at,
)
from .types import WIDTH

__all__ = [
    "WIDTH",
    "add_at",
    "any_of",
    "at",
    "bits_of",
    "count",
    "first_lanes",
    "float32",
    "float64",
    "float_of",
    "floor",
    "int32",
    "lanes",
    "load",
    "load_parts",
    "no",
    "put_at",
    "select",
    "spread",
    "store",
    "store_front",
    "store_parts",
    "to_index",
    "total",
    "uint32",
    "words_at",
]
