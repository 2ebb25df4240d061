"""Scenes whose surfaces are made of other triangles, have other normals, or stand elsewhere with all their digits lost.

Every function gives a new `engine.Scene`; where it doesn't say otherwise, with the picture of the old one.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from engine.scene import Instances, Mesh, Scene

MILLION = 1_000_000
TINY = 2.0**-10
ASPECT = 1e8
CUTS = 8  # places along a mesh where it is cut


def with_meshes(scene: Scene, change: Callable[[Mesh], Mesh]) -> Scene:
    return replace(scene, meshes=[change(mesh) for mesh in scene.meshes])


def emits(scene: Scene) -> np.ndarray:
    """(number of meshes,) bool: some instance of the mesh has an emissive material."""
    instances, out = scene.instances, np.zeros(len(scene.meshes), bool)
    glows = np.array([max(material.emission) > 0 for material in scene.materials])
    for mesh, first, count in zip(instances.mesh, instances.material_offset, instances.slot_count, strict=True):
        out[mesh] |= glows[instances.material_table[first : first + count]].any()
    return out


def selected(scene: Scene, rows) -> Scene:
    """With these instances only, in this order."""
    old = scene.instances
    fields = ("mesh", "transforms", "material_offset", "slot_count", "visibility", "object")
    return replace(scene, instances=replace(old, **{name: getattr(old, name)[rows] for name in fields}))


def doubled(scene: Scene) -> Scene:
    """Every mesh that doesn't shine is placed once more, tiny and behind the camera: where nothing is baked, all of
    the scene is instances."""
    dark = np.flatnonzero(~emits(scene))
    out = selected(scene, [*range(len(scene.instances)), *(np.argmax(scene.instances.mesh == k) for k in dark)])
    assert scene.camera is not None
    behind = scene.camera.transform @ (0, 0, 1, 1)
    for row, mesh in enumerate(dark, len(scene.instances)):
        size = np.ptp(scene.meshes[mesh].bounds(), axis=0).max()
        out.instances.transforms[row] = shrunk(behind, scene.meshes[mesh], 2.0 ** np.floor(np.log2(TINY / size)))
    return out


def shrunk(centre: np.ndarray, mesh: Mesh, factor: float) -> np.ndarray:
    """(3, 4), which puts the mesh's middle to `centre`."""
    return np.column_stack([factor * np.eye(3), centre - factor * mesh.bounds().mean(axis=0)])


# Normals


def normals_times(factor: float) -> Callable[[Scene], Scene]:
    def change(mesh: Mesh) -> Mesh:
        assert mesh.normals is not None
        return replace(mesh, normals=(mesh.normals * np.float32(factor)).astype(np.float32))

    return lambda scene: with_meshes(with_normals(scene), change)


def with_normals(scene: Scene) -> Scene:
    """Flat meshes with normals all the same: those of their faces."""
    return with_meshes(scene, lambda mesh: mesh if mesh.normals is not None else _with_face_normals(mesh))


def _with_face_normals(mesh: Mesh) -> Mesh:
    a, b, c = np.moveaxis(mesh.vertices[mesh.triangles].astype(np.float64), 1, 0)
    normals = np.cross(b - a, c - a)
    normals /= np.maximum(np.linalg.norm(normals, axis=1), 1e-300)[:, None]
    rows = np.repeat(np.arange(len(mesh.triangles), dtype=np.uint32)[:, None], 3, axis=1)
    return replace(mesh, normals=normals.astype(np.float32), normal_indices=rows)


def flat(scene: Scene) -> Scene:
    """Another picture, where something is smooth."""
    return with_meshes(scene, lambda mesh: replace(mesh, normals=None, normal_indices=None))


def inside_out(scene: Scene) -> Scene:
    """Faces wound the other way round, and normals to match."""

    def change(mesh: Mesh) -> Mesh:
        indices, normals = mesh.normal_indices, mesh.normals
        return replace(
            mesh,
            triangles=_turned(mesh.triangles),
            normals=None if normals is None else -normals,
            normal_indices=None if indices is None else _turned(indices),
        )

    return with_meshes(scene, change)


def _turned(corners: np.ndarray) -> np.ndarray:
    return np.ascontiguousarray(corners[:, [0, 2, 1]])


# Triangles


def coincident(scene: Scene) -> Scene:
    """A million triangles, most of them copies: of all but what shines, which would shine as many times as bright."""
    dark = ~emits(scene)
    count = sum(len(mesh.triangles) for mesh, copied in zip(scene.meshes, dark, strict=True) if copied)
    times = -(-MILLION // count)
    meshes = [_repeated(mesh, times) if copied else mesh for mesh, copied in zip(scene.meshes, dark, strict=True)]
    return replace(scene, meshes=meshes)


def _repeated(mesh: Mesh, times: int) -> Mesh:
    indices, slots = mesh.normal_indices, mesh.material_slots
    return replace(
        mesh,
        triangles=np.tile(mesh.triangles, (times, 1)),
        normal_indices=None if indices is None else np.tile(indices, (times, 1)),
        material_slots=None if slots is None else np.tile(slots, times),
    )


def slivers(scene: Scene) -> Scene:
    """Every mesh cut across into strips 1e8 times as long as wide where float32 has such, and else one ulp wide."""
    return with_meshes(scene, cut_into_slivers)


def cut_into_slivers(mesh: Mesh) -> Mesh:
    low, high = mesh.bounds().astype(np.float64)
    around_0 = (low < 0) & (high > 0)
    axis = int(np.argmax((high - low) * np.where(around_0.any(), around_0, True)))
    places = low[axis] + (high[axis] - low[axis]) * (np.arange(CUTS) + 0.5) / CUTS
    corners, slots = _corners(mesh), mesh.material_slots
    if slots is None:
        slots = np.zeros(len(corners), np.int32)
    for place in np.append(places, 0.0 if around_0[axis] else places[0]).astype(np.float32):
        other = np.float32(place + (high - low).max() / ASPECT)
        for x in (place, max(other, np.nextafter(place, np.float32(np.inf)))):
            corners, slots = cut(corners, slots, axis, x)
    rows = np.arange(3 * len(corners), dtype=np.uint32).reshape(-1, 3)
    points = np.ascontiguousarray(corners[:, :, :3].reshape(-1, 3))
    normals = None if mesh.normals is None else _unit(corners[:, :, 3:].reshape(-1, 3))
    return Mesh(mesh.name, points, rows, normals, material_slots=slots)


def _corners(mesh: Mesh) -> np.ndarray:
    """(T, 3, 3) or with normals (T, 3, 6) float32."""
    points = mesh.vertices[mesh.triangles]
    if mesh.normals is None:
        return points
    indices = mesh.triangles if mesh.normal_indices is None else mesh.normal_indices
    return np.concatenate([points, mesh.normals[indices]], axis=2)


def _unit(vectors: np.ndarray) -> np.ndarray:
    lengths = np.linalg.norm(vectors.astype(np.float64), axis=1)[:, None]
    return (vectors / np.maximum(lengths, 1e-300)).astype(np.float32)


def cut(corners: np.ndarray, slots: np.ndarray, axis: int, x: np.float32) -> tuple[np.ndarray, np.ndarray]:
    """Triangles (T, 3, k) and slots (T,), those on both sides of the plane at `x` in two or three parts. Of an edge
    that two triangles share, both get the same point."""
    side = np.sign(corners[:, :, axis] - x).astype(int)
    crossing = (side.min(axis=1) < 0) & (side.max(axis=1) > 0)
    kept, parts, slots_of_parts = corners[~crossing], [], []
    corners, side, slots_crossing = corners[crossing], side[crossing], slots[crossing]
    # The corner on the plane first, or else the one that is alone on its side.
    on_plane = (side == 0).any(axis=1)
    alone = side == -np.sign(side.sum(axis=1))[:, None]
    first = np.argmax(np.where(on_plane[:, None], side == 0, alone), axis=1)
    order = (first[:, None] + np.arange(3)) % 3
    a, b, c = np.moveaxis(np.take_along_axis(corners, order[:, :, None], axis=1), 1, 0)
    p = _between(b, c, axis, x)
    two = [(a, b, p), (a, p, c)]
    p, q = _between(a, b, axis, x), _between(a, c, axis, x)
    three = [(a, p, q), (p, b, c), (p, c, q)]
    for triangles, rows in [(two, on_plane), (three, ~on_plane)]:
        for triangle in triangles:
            parts.append(np.stack(triangle, axis=1)[rows])
            slots_of_parts.append(slots_crossing[rows])
    return np.concatenate([kept, *parts]), np.concatenate([slots[~crossing], *slots_of_parts])


def _between(a: np.ndarray, b: np.ndarray, axis: int, x: np.float32) -> np.ndarray:
    """Where the edges (T, k) pass `x`; whatever, where they don't."""
    swap = (a[:, axis] > b[:, axis])[:, None]
    low, high = np.where(swap, b, a).astype(np.float64), np.where(swap, a, b).astype(np.float64)
    span = high[:, axis] - low[:, axis]
    part = np.divide(x - low[:, axis], span, out=np.zeros_like(span), where=span > 0)
    out = (low + part[:, None] * (high - low)).astype(np.float32)
    out[:, axis] = x
    return out


# Places


def rounded_through(scene: Scene, matrix: np.ndarray) -> Scene:
    """With the shapes that float32 leaves of them when they are stored as seen through `matrix` (3, 3)."""
    inverse = np.linalg.inv(matrix)

    def change(mesh: Mesh) -> Mesh:
        stored = (mesh.vertices @ inverse.T).astype(np.float32)
        return replace(mesh, vertices=(stored @ matrix.T).astype(np.float32))

    return with_meshes(scene, change)


def own_meshes(scene: Scene, most: int = 100_000) -> Scene:
    """Every mesh about its own origin, so that a transform's last column is where it is, and used once unless its
    copies have more triangles than `most`."""
    meshes, numbers, centres = [], np.empty(len(scene.instances), np.int32), np.empty((len(scene.instances), 3))
    for index, mesh in enumerate(scene.meshes):
        rows = np.flatnonzero(scene.instances.mesh == index)
        centres[rows] = mesh.bounds().astype(np.float64).mean(axis=0)
        mesh = replace(
            mesh, vertices=(mesh.vertices - mesh.bounds().astype(np.float64).mean(axis=0)).astype(np.float32)
        )
        copies = len(rows) if len(rows) * len(mesh.triangles) <= most else 1
        numbers[rows] = len(meshes) + np.arange(len(rows)) % copies
        meshes += [mesh] * copies
    transforms = scene.instances.transforms.copy()
    transforms[:, :, 3] += np.einsum("nij,nj->ni", transforms[:, :, :3], centres)
    return replace(scene, meshes=meshes, instances=replace(scene.instances, mesh=numbers, transforms=transforms))


def rounded(values: np.ndarray, by: np.ndarray) -> np.ndarray:
    """To what float32 has at `by`."""
    return (values + by).astype(np.float32).astype(np.float64) - by


def rounded_at(scene: Scene, by: np.ndarray) -> Scene:
    """A scene of `own_meshes` with the vertices, the instances, the camera and the lamps that float32 makes of it when
    moved by `by` (3,); but where it was. Another picture."""
    transforms, meshes = scene.instances.transforms.copy(), list(scene.meshes)
    uses = np.bincount(scene.instances.mesh, minlength=len(meshes))
    for row, index in enumerate(scene.instances.mesh):
        linear, origin = transforms[row, :, :3], transforms[row, :, 3]
        if uses[index] == 1:
            world = rounded(meshes[index].vertices @ linear.T + origin, by)
            vertices = (world - origin) @ np.linalg.inv(linear).T
            meshes[index] = replace(meshes[index], vertices=vertices.astype(np.float32))
        else:
            transforms[row, :, 3] = rounded(origin, by)
    lights = [replace(light, transform=_rounded_place(light.transform, by)) for light in scene.lights]
    assert scene.camera is not None
    camera = replace(scene.camera, transform=_rounded_place(scene.camera.transform, by))
    instances = replace(scene.instances, transforms=transforms)
    return replace(scene, meshes=meshes, instances=instances, lights=lights, camera=camera)


def _rounded_place(transform: np.ndarray, by: np.ndarray) -> np.ndarray:
    return np.column_stack([transform[:, :3], rounded(transform[:, 3], by)])


def with_pebble(scene: Scene, place) -> Scene:
    """A triangle of a millimetre at `place` (3,), far off: it keeps the engine from moving the scene to the origin."""
    out = replace(scene, meshes=list(scene.meshes))
    corners = np.array([[0, 0, 0], [1e-3, 0, 0], [0, 1e-3, 0]], np.float32)
    pebble = Mesh("pebble", corners, np.array([[0, 1, 2]], np.uint32))
    out.add_instance(pebble, np.column_stack([np.eye(3), place]))
    return out


def without_surfaces(scene: Scene) -> Scene:
    """Another picture."""
    return replace(scene, meshes=[], instances=Instances())
