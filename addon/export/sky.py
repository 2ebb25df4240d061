"""Blender's Sky Texture: the sky by direction, and its sun, from a table that `tools/skies.py` renders with Cycles.

The table has each type of sky at some elevations of the sun, in the air that the texture has unless told otherwise.
Between these it is interpolated. Nothing here knows what the node is linked to: see world.py.
"""

from __future__ import annotations

import functools
from math import asin, cos, degrees, pi, sin
from pathlib import Path
from typing import NamedTuple

import numpy as np

TABLE = Path(__file__).with_name("skies.npz")
DARKEST = 1e-6  # W/(m2 sr), of what is interpolated by its logarithm
SMALLEST_DISK = 5e-4  # radians: Cycles, scene/shader_nodes.cpp, get_sun_size
BY_DIRECTION = ("PREETHAM", "HOSEK_WILKIE")  # the sun is a vector there, without a disk

# What the table holds, of each setting that changes the sky: from and to.
IN_TABLE = {
    "air_density": (1.0, 1.0),
    "dust_density": (1.0, 1.0),
    "aerosol_density": (1.0, 1.0),  # dust from Blender 5.0 on
    "ozone_density": (1.0, 1.0),
    "altitude": (0.0, 100.0),  # the defaults before and from Blender 5.0 on
}
IN_TABLE_BY_DIRECTION = {"turbidity": (2.2, 2.2), "ground_albedo": (0.3, 0.3)}


class Sun(NamedTuple):
    """The disk.

    direction   (3,) unit, to it
    angle       radians, its diameter
    irradiance  (3,) W/m2 on a surface that faces it
    """

    direction: np.ndarray
    angle: float
    irradiance: np.ndarray


class _Kind(NamedTuple):
    """Of one type of sky.

    radiance    (E, H, A, 3) float64, W/(m2 sr), without the disk
    irradiance  (E, 3) float64, W/m2 of the disk at an intensity of 1
    """

    radiance: np.ndarray
    irradiance: np.ndarray


class _Table(NamedTuple):
    """elevations (E,) of the sun, heights (H,) and azimuths (A,) of a direction, from the sun's on: degrees, rising."""

    elevations: np.ndarray
    heights: np.ndarray
    azimuths: np.ndarray
    kinds: dict[str, _Kind]


def sky_radiance(node, directions: np.ndarray) -> np.ndarray:
    """(..., 3) of unit vectors (..., 3), without the sun's disk."""
    table, sky = _table(), _at_elevation(node)
    sun = sun_direction(node)
    turn = np.arctan2(directions[..., 1], directions[..., 0]) - np.arctan2(sun[1], sun[0])
    away = np.degrees(np.abs((turn + pi) % (2.0 * pi) - pi))  # the sky is alike on both sides of the sun
    row, y = _between(table.heights, np.degrees(np.arcsin(np.clip(directions[..., 2], -1.0, 1.0))))
    column, x = _between(table.azimuths, away)
    x, y = x[..., None], y[..., None]
    low = (1.0 - x) * sky[row, column] + x * sky[row, column + 1]
    high = (1.0 - x) * sky[row + 1, column] + x * sky[row + 1, column + 1]
    return (1.0 - y) * low + y * high


def mean_sky(node) -> np.ndarray:
    """(3,): over all directions, without the sun's disk."""
    return sky_radiance(node, _evenly_spread()).mean(axis=0)


def sun_of(node) -> Sun | None:
    """None where no disk is drawn: it is switched off, has set, or the type of sky has none."""
    if node.sky_type in BY_DIRECTION or not node.sun_disc:
        return None
    table, elevation, angle = _table(), _elevation(node), max(node.sun_size, SMALLEST_DISK)
    if elevation <= -angle / 2.0:
        return None
    height = degrees(elevation)
    irradiance = [np.interp(height, table.elevations, column) for column in _kind(node).irradiance.T]
    irradiance = node.sun_intensity * np.array(irradiance)
    return Sun(sun_direction(node), angle, irradiance) if irradiance.any() else None


def sun_direction(node) -> np.ndarray:
    """(3,) unit, to the sun."""
    if node.sky_type in BY_DIRECTION:
        return np.array(node.sun_direction.normalized())
    elevation, rotation = node.sun_elevation, node.sun_rotation  # clockwise from +y, seen from above
    return np.array([cos(elevation) * sin(rotation), cos(elevation) * cos(rotation), sin(elevation)])


def not_in_table(node) -> list[str]:
    """What the sky depends on and is drawn otherwise, by the names that the user sees."""
    wanted = IN_TABLE_BY_DIRECTION if node.sky_type in BY_DIRECTION else IN_TABLE
    known = node.bl_rna.properties
    asked = {name: getattr(node, name) for name in wanted if name in known}
    if node.sky_type == "PREETHAM":
        asked.pop("ground_albedo")
    margin = 1e-4  # of float32
    return [
        known[name].name.lower()
        for name, value in asked.items()
        if not wanted[name][0] - margin <= value <= wanted[name][1] + margin
    ]


def _elevation(node) -> float:
    """Of the sun above the horizon, radians; past the zenith it comes down again."""
    return asin(min(max(sun_direction(node)[2], -1.0), 1.0))


def _at_elevation(node) -> np.ndarray:
    """(H, A, 3)"""
    skies = _kind(node).radiance
    place, share = _between(_table().elevations, np.array(degrees(_elevation(node))))
    low, high = np.maximum(skies[place], DARKEST), np.maximum(skies[place + 1], DARKEST)
    return low * (high / low) ** share


def _between(nodes: np.ndarray, at: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The last of the rising `nodes` below each place, never the very last, and how far it is on the way to the next,
    [0, 1]."""
    index = np.clip(np.searchsorted(nodes, at, side="right") - 1, 0, len(nodes) - 2)
    return index, np.clip((at - nodes[index]) / (nodes[index + 1] - nodes[index]), 0.0, 1.0)


def _kind(node) -> _Kind:
    kinds = _table().kinds
    return kinds.get(node.sky_type) or kinds["SINGLE_SCATTERING"]  # NISHITA, before Blender 5.0


@functools.cache
def _table() -> _Table:
    with np.load(TABLE) as file:
        axes = {name: file[name].astype(np.float64) for name in ("elevations", "heights", "azimuths")}
        names = [name.removesuffix(" disk") for name in file if name.endswith(" disk")]
        kinds = {name: _Kind(file[name].astype(np.float64), file[f"{name} disk"].astype(np.float64)) for name in names}
    return _Table(**axes, kinds=kinds)


@functools.cache
def _evenly_spread(rings: int = 64) -> np.ndarray:
    """(N, 3) unit vectors that have equal parts of the sphere."""
    z = (2.0 * np.arange(rings) + 1.0) / rings - 1.0
    azimuth = (np.arange(2 * rings) + 0.5) / rings * pi
    z, azimuth = (values.ravel() for values in np.meshgrid(z, azimuth))
    ring = np.sqrt(1.0 - z * z)
    return np.stack([ring * np.cos(azimuth), ring * np.sin(azimuth), z], axis=-1)
