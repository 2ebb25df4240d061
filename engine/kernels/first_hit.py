"""What the camera sees first, for the passes that show it: places, normals, colours, indices.

The rays of a pixel's samples are traced once more, so that no kernel that follows paths knows of these passes, and one
more through the middle of the pixel where a mean would say nothing (the middle of the lens, too). Means go on through
transparent surfaces, each weighed by what it covers, as in Cycles; what has one value only is that of the first
surface that covers enough. Holdouts are nothing there: what they hide is hidden here too.
"""

from __future__ import annotations

import math

import numpy as np

from ..features import DARK_WORLD, Features
from .camera import generate_ray
from .camera.layout import FORWARD, ORIGIN, PIXEL_X, PIXEL_Y
from .direct import dimmed_on_way
from .embree import TFAR, intersect
from .geom.frame import to_world
from .geom.surface import find_surface, hit_of, offset_origin
from .geom.vec import (
    BLACK,
    HALF,
    ONE,
    ZERO,
    add,
    average,
    dot,
    is_black,
    length,
    mul,
    negate,
    normalize,
    scale,
    sub,
)
from .jit import device, kernel
from .light.emitters import emission
from .met import world_behind
from .records import (
    DIRECTION,
    FIRST_VERTEX,
    MAX_TRANSPARENT,
    WHITE,
    Numbers,
    RayMemory,
    Stretch,
    material_color,
)
from .sampler.sobol import hash_pixel, sample_2d, start_sample
from .sampler.warp import cosine_hemisphere
from .tables import (
    AO_DISTANCE,
    CAMERA_RAY,
    KD,
    KS,
    LETS_THROUGH,
    MIST_FALLOFF,
    MIST_PER_METRE,
    MIST_START,
    MOVE_FACTOR,
    MOVE_X,
    TRANSPARENCY,
    words,
)
from .vertex import camera_ray, is_holdout

# Places in `engine.passes.DATA`.
DEPTH, POSITION, OBJECT_INDEX, MATERIAL_INDEX = words(0, 1, 2, 3)
MIST, NORMAL, UV, DIFFUSE_COLOR, GLOSSY_COLOR, OCCLUSION, ALBEDO, CAMERA_NORMAL = words(4, 5, 6, 7, 8, 9, 10, 11)
NOTHING_THERE = 1e10  # the depth of the background, as in Cycles


@device
def _add(out, columns, data, value):
    first = columns[data]
    if first >= 0:
        out[first] += value


@device
def _add_3(out, columns, data, value):
    first = columns[data]
    if first >= 0:
        out[first] += value[0]
        out[first + 1] += value[1]
        out[first + 2] += value[2]


@device
def _to_camera(camera, v):
    """A direction in the camera's space: x to the right, y up, z along the axis."""
    right = normalize((camera[PIXEL_X], camera[PIXEL_X + 1], camera[PIXEL_X + 2]))
    up = normalize((camera[PIXEL_Y], camera[PIXEL_Y + 1], camera[PIXEL_Y + 2]))
    return dot(v, right), dot(v, up), dot(v, _axis(camera))


@device
def _axis(camera):
    return camera[FORWARD], camera[FORWARD + 1], camera[FORWARD + 2]


@device
def _from_camera(camera, p):
    return sub(p, (camera[ORIGIN], camera[ORIGIN + 1], camera[ORIGIN + 2]))


# --- what a surface is ------------------------------------------------------------------------------------------------


@device
def _uv(surfaces, hit):
    """(u, v, 1), or zeros on a mesh without them."""
    if surfaces.uv_row[hit.triangle] < 0:
        return BLACK
    corners = surfaces.uvs[surfaces.uv_row[hit.triangle]]
    w = ONE - hit.u - hit.v
    return (
        w * corners[0, 0] + hit.u * corners[1, 0] + hit.v * corners[2, 0],
        w * corners[0, 1] + hit.u * corners[1, 1] + hit.v * corners[2, 1],
        ONE,
    )


@device
def _object_index(surfaces, hit):
    if hit.instance >= 0:
        return surfaces.instance_index[hit.instance]
    return surfaces.triangle_index[hit.triangle]


@device
def _mist(f, tables, surfaces, p):
    """How much shows through the mist at p."""
    numbers, way = surfaces.numbers, _from_camera(tables.camera, p)
    far = abs(dot(way, _axis(tables.camera))) if f.orthographic else length(way)
    mist = min(max((np.float64(far) - numbers[MIST_START]) * numbers[MIST_PER_METRE], 0.0), 1.0)
    if numbers[MIST_FALLOFF] == 2.0:
        mist = mist * mist
    elif numbers[MIST_FALLOFF] == 0.5:
        mist = math.sqrt(mist)
    return 1.0 - mist


@device
def _unoccluded(f, tables, surfaces, memory, numbers, surface):
    """(what arrives at a surface along a random direction from as far as the distance, rays traced)."""
    _, n, ng, _, _, inside = surface
    u1, u2 = sample_2d(tables.sampler, numbers.key, numbers.order, FIRST_VERTEX + DIRECTION)
    wi = to_world(cosine_hemisphere(u1, u2), n)
    distance = np.float32(surfaces.numbers[AO_DISTANCE])
    if not dot(wi, ng) > ZERO:
        return BLACK, 0
    if not distance > ZERO:
        return WHITE, 0
    start = offset_origin(inside, ng)
    return dimmed_on_way(f, tables.geometry, memory, start, scale(wi, distance), ONE, WHITE)


# --- samples ----------------------------------------------------------------------------------------------------------


@device
def _add_sample(f, tables, surfaces, memory, out, columns, pixel_x, pixel_y, pixel_hash, index):
    """Add what a sample's ray meets to the sums. Returns the number of rays traced."""
    key, order = start_sample(pixel_hash, index)
    numbers = Numbers(key, order, FIRST_VERTEX)
    ray, stretch = camera_ray(f, tables, numbers, pixel_x, pixel_y)
    through, rays, is_covered = WHITE, 0, False
    for _ in range(MAX_TRANSPARENT):
        accel, floats = tables.geometry.accel[0], memory.floats
        rays += 1
        if not intersect(accel, floats, memory.words, stretch.start, ray.wi, stretch.t_near, stretch.t_far, CAMERA_RAY):
            if f.world != DARK_WORLD:
                _add_3(out, columns, ALBEDO, mul(through, world_behind(f, tables, ray.wi)))
            break
        hit, left = hit_of(f, tables.geometry, floats, memory.words), stretch.t_far - floats[TFAR]
        surface = find_surface(f, tables.geometry, hit, negate(ray.wi))
        material = surface[3]
        lets_through = material_color(tables.geometry, material, TRANSPARENCY)
        if is_holdout(f, tables.geometry, material):
            covers = BLACK  # a hole hides what is behind it, and shows nothing
        else:
            covers = sub(WHITE, lets_through)
            _add_surface(f, tables, surfaces, out, columns, surface, through, mul(through, covers))
            if not is_covered and _is_shown(surfaces, lets_through):
                _add_3(out, columns, NORMAL, surface[1])
                if columns[UV] >= 0:
                    _add_3(out, columns, UV, _uv(surfaces, hit))
        is_covered = is_covered or _is_shown(surfaces, lets_through)
        if columns[OCCLUSION] >= 0 and not is_black(covers):
            free, more = _unoccluded(f, tables, surfaces, memory, numbers, surface)
            _add_3(out, columns, OCCLUSION, mul(mul(through, covers), free))
            rays += more
        if not f.transparency or is_black(lets_through):
            break
        through = mul(through, lets_through)
        stretch = Stretch(offset_origin(surface[5], negate(surface[2])), ZERO, left, ZERO)
    return rays


@device
def _is_shown(surfaces, lets_through):
    """Whether a surface covers enough for what can't be mixed with anything behind it."""
    return average(lets_through) <= surfaces.numbers[LETS_THROUGH]


@device
def _add_surface(f, tables, surfaces, out, columns, surface, through, weight):
    """Add a surface's share of the means. through: what arrives of it at the camera; weight: times what it covers."""
    p, n, _, material, _, _ = surface
    geometry = tables.geometry
    kd, ks = material_color(geometry, material, KD), material_color(geometry, material, KS)
    _add_3(out, columns, DIFFUSE_COLOR, mul(through, kd))
    _add_3(out, columns, GLOSSY_COLOR, mul(through, ks))
    if columns[MIST] >= 0:
        _add(out, columns, MIST, np.float64(average(weight)) * _mist(f, tables, surfaces, p))
    albedo = add(kd, ks)
    if f.mesh_emitters:
        albedo = add(albedo, emission(geometry, material))
    _add_3(out, columns, ALBEDO, mul(through, albedo))
    if columns[CAMERA_NORMAL] >= 0:
        _add_3(out, columns, CAMERA_NORMAL, scale(_to_camera(tables.camera, n), average(weight)))


# --- the middle of the pixel ------------------------------------------------------------------------------------------


@device
def _look_once(f, tables, surfaces, memory, out, columns, pixel_x, pixel_y):
    """Write down what the ray through the middle of the pixel meets. Returns the number of rays traced."""
    x, y = np.float32(pixel_x) + HALF, np.float32(pixel_y) + HALF
    start, wi, t_near, t_far = generate_ray(tables.camera, f.orthographic, 0, x, y, ZERO, ZERO)
    rays = 0
    for _ in range(MAX_TRANSPARENT):
        rays += 1
        if not intersect(tables.geometry.accel[0], memory.floats, memory.words, start, wi, t_near, t_far, CAMERA_RAY):
            break
        hit = hit_of(f, tables.geometry, memory.floats, memory.words)
        t_near, t_far = ZERO, t_far - memory.floats[TFAR]
        surface = find_surface(f, tables.geometry, hit, negate(wi))
        lets_through = material_color(tables.geometry, surface[3], TRANSPARENCY)
        if _is_shown(surfaces, lets_through):
            if is_holdout(f, tables.geometry, surface[3]):
                break
            _write(tables, surfaces, out, columns, surface, hit)
            return rays
        start = offset_origin(surface[5], negate(surface[2]))
    if columns[DEPTH] >= 0:
        out[columns[DEPTH]] = NOTHING_THERE
    return rays


@device
def _write(tables, surfaces, out, columns, surface, hit):
    p, numbers = surface[0], surfaces.numbers
    if columns[DEPTH] >= 0:
        depth = dot(_from_camera(tables.camera, p), _axis(tables.camera))
        out[columns[DEPTH]] = np.float64(depth) / numbers[MOVE_FACTOR]
    if columns[POSITION] >= 0:
        for axis in range(3):
            place = np.float64(p[axis]) / numbers[MOVE_FACTOR] + numbers[MOVE_X + axis]
            out[columns[POSITION] + axis] = place
    if columns[OBJECT_INDEX] >= 0:
        out[columns[OBJECT_INDEX]] = _object_index(surfaces, hit)
    if columns[MATERIAL_INDEX] >= 0:
        out[columns[MATERIAL_INDEX]] = surfaces.material_index[surface[3]]


@device
def _any_of(columns, first, end):
    """Whether any of these is summed up."""
    found = False
    for data in range(first, end):
        found |= columns[data] >= 0
    return found


def make_first_hit_kernel(features: Features):
    """The kernel that sums up what the first surfaces of a tile's samples are."""

    @kernel
    def first_hits(
        tables, surfaces, ray, tile, first_sample, sample_count, seed, origin, data, columns, active, halt
    ):  # fmt: skip
        """Add samples first_sample.. of the pixels of `tile` to `engine.passes.PassFilm.data`; the rest is as the path
        kernels have it. With sample 0 come the values of the middle of the pixel. Returns the number of rays."""
        memory = RayMemory(ray, ray.view(np.uint32))
        in_the_middle, means = _any_of(columns, DEPTH, MIST), _any_of(columns, MIST, len(columns))
        rays = 0
        for y in range(tile[1], tile[3]):
            for x in range(tile[0], tile[2]):
                row, column = y - origin[1], x - origin[0]
                if halt[0]:
                    return rays
                if active.size > 1 and not active[row, column]:
                    continue
                out, pixel_hash = data[row, column], hash_pixel(x, y, seed)
                if in_the_middle and first_sample == 0:
                    rays += _look_once(features, tables, surfaces, memory, out, columns, x, y)
                if means:
                    for index in range(first_sample, first_sample + sample_count):
                        rays += _add_sample(features, tables, surfaces, memory, out, columns, x, y, pixel_hash, index)
                    out[-1] += sample_count
        return rays

    return first_hits
