"""Renders with other features than the scene asks for: what it doesn't use switched on, for tests and benchmarks that
compare, and to spare the compilation of a kernel for each of a thousand random scenes.

`engine.features` decides which tables have rows, so the tables of a feature that is forced on are filled up with rows
that say "there is none".
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator
from unittest import mock

import numpy as np

import engine.pack.lights as packing_lights
from engine import schedule
from engine.features import CONSTANT_WORLD, EMITTER_TREE, EVERYTHING, IMAGE_WORLD, Features
from engine.kernels.light.environment import build_environment
from engine.pack import Packed
from engine.pack.geometry import INVALID, corners


def filled_up(packed: Packed, features: Features) -> Packed:
    """`packed` with these features and tables that suit them."""
    geometry, lights = packed.geometry, packed.lights
    faces, emitters = len(geometry.triangles), len(lights.emitter_triangle)
    if features.smooth and len(geometry.normal_triangles) < faces:
        normal_triangles = corners(faces)
        normal_triangles[:] = INVALID
        geometry = geometry._replace(normal_triangles=normal_triangles)
    if features.mesh_emitters and len(lights.triangle_emitter) < faces:
        lights = lights._replace(triangle_emitter=np.full(faces, -1, np.int32))
    if features.rectangle_emitters and len(lights.emitter_rectangle) < emitters:
        lights = lights._replace(emitter_rectangle=np.zeros((emitters, 9), np.float32))
    if features.world == IMAGE_WORLD and packed.features.world == CONSTANT_WORLD:
        packed.environment = build_environment(np.ones((1, 1, 3), np.float32))
    packed.geometry, packed.lights, packed.features = geometry, lights, features
    return packed


@contextlib.contextmanager
def forced(change: Callable[[Features], Features]) -> Iterator[None]:
    """Within, the compiled road renders with the features that `change` makes of the scene's own."""
    pack_next, choice_tree = schedule.pack_next, packing_lights.choice_tree
    wants_tree = change(Features()).emitter_choice == EMITTER_TREE

    def packed_otherwise(*arguments) -> Packed:
        packed = pack_next(*arguments)
        return filled_up(packed, change(packed.features))

    with (
        mock.patch.object(schedule, "pack_next", packed_otherwise),
        mock.patch.object(packing_lights, "choice_tree", lambda e, groups: choice_tree(e, 2 if wants_tree else groups)),
    ):
        yield


# Of what `EVERYTHING` switches on, what makes paths of one stage differ: see `is_mixed` of engine/kernels/batch.py.
MIXED = ("transparency", "ray_kinds")


def everything_alike_on() -> contextlib.AbstractContextManager[None]:
    """As `everything_on`, with all paths of a stage alike."""
    alike = {name: value for name, value in EVERYTHING.items() if name not in MIXED}
    return forced(lambda features: features._replace(**alike))


def everything_on() -> contextlib.AbstractContextManager[None]:
    """One kernel for all scenes, but for the few features that `EVERYTHING` leaves as they are."""
    return forced(lambda features: features._replace(**EVERYTHING))
