"""The long edits of `trials.py`: (file, text, other text).

All leave the mean of the picture what it is: `tests/tools/test_trial_edits.py` renders with those of the estimator.
"""

from __future__ import annotations

KERNELS = "engine/kernels/"
Edits = list[tuple[str, str, str]]

# What a sphere covers is sampled by way of any of its points, of which a ray meets two.
_BY_AREA = """\
    height, ring = ONE - TWO * u1, radius * TWO * math.sqrt(u1 * (ONE - u1))
    sine, cosine = sin_cos_turn(u2)
    wi, _ = direction_and_length(
        (to_center[0] + ring * cosine, to_center[1] + ring * sine, to_center[2] + radius * height)
    )
    t, pdf = _both_points(to_center, radius, wi)
"""
_BOTH_POINTS = '''@device
def _both_points(to_center, radius, wi):
    """(distance of the nearer point, density of points uniform in area)"""
    along, off = dot(to_center, wi), cross(to_center, wi)
    half = math.sqrt(max(radius * radius - dot(off, off), SMALL))
    near, far = along - half, along + half
    return near, (near * near + far * far) / (TWO * TWO * PI * radius * half)


@device
def sample_sphere('''

SPHERES_BY_AREA: Edits = [
    (
        KERNELS + "light/spherical.py",
        """\
    local = uniform_cone(u1, u2, cap)
    sine_squared = local[0] * local[0] + local[1] * local[1]
    wi, pdf = to_world(local, axis), uniform_cone_pdf(cap)
    t = d * local[2] - math.sqrt(max(r_squared - d_squared * sine_squared, ZERO))
""",
        _BY_AREA,
    ),
    (
        KERNELS + "light/spherical.py",
        "    outside_pdf = uniform_cone_pdf(one_minus_cos(min(r_squared / d_squared, ONE)))\n",
        "    _, outside_pdf = _both_points(to_center, radius, wi)\n",
    ),
    (KERNELS + "light/spherical.py", "@device\ndef sample_sphere(", _BOTH_POINTS),
]

# In place of x a counter, whose even bits are the column in the tile and whose odd bits are the row.
_MORTON_ORDER = """@device
def _even_bits(m):
    found = NONE
    for bit in range(16):
        found |= ((m >> (2 * bit)) & 1) << bit
    return found


@device
def _next_samples(batch, tile, first_sample, sample_count, origin, active, x, y, done):
    words, n, adaptive = batch.sample_words, NONE, active.size > 1
    side = 1
    while side < max(tile[2] - tile[0], tile[3] - tile[1]):
        side *= 2
    while n < BATCH and y < tile[3]:
        column, row = tile[0] + _even_bits(x - tile[0]), tile[1] + _even_bits((x - tile[0]) >> 1)
        within = column < tile[2] and row < tile[3] and done < sample_count
        if within and (not adaptive or active[row - origin[1], column - origin[0]]):
            words[rows.X, n], words[rows.Y, n] = np.uint32(column), np.uint32(row)
            words[rows.INDEX, n] = np.uint32(first_sample + done)
            n, done = n + 1, done + 1
            continue
        done, x = NONE, x + 1
        if x - tile[0] >= side * side:
            y = tile[3]
    return n, x, y, done


@device
def _next_samples_by_rows("""
IN_MORTON_ORDER: Edits = [(KERNELS + "staged.py", "@device\ndef _next_samples(", _MORTON_ORDER)]

# A receiver is its normal, and behind it the mirror direction, the Phong exponent and the lobe's share of what it
# reflects. A cluster's importance is multiplied by the lobe's value toward its centre, made as much wider as the
# cluster is wide, beside that of a diffuse surface. Paths carry the receiver along in place of the normal.
_LOBE = '''@device
def _lobe_toward(receiver, to, half):
    """The mean of the BRDF over a cluster at `to`, as a multiple of a diffuse surface's; never 0."""
    mirror, exponent, share = (receiver[3], receiver[4], receiver[5]), receiver[6], receiver[7]
    distance_squared, radius_squared = min(dot(to, to), LARGE), min(dot(half, half), LARGE)
    inverse = ONE / math.sqrt(distance_squared + SMALL)
    width = ONE - math.sqrt(distance_squared / (distance_squared + radius_squared + SMALL))
    power = ONE / (ONE / (exponent + ONE) + width)
    drop = max(ONE - dot(mirror, to) * inverse, ZERO)
    beyond = drop >= ONE
    lobe = select(beyond, ZERO, exp(power * log_one_minus(select(beyond, ZERO, drop))))
    return ONE - share + share * max(HALF * (power + ONE) * lobe, _LEAST_LOBE)


@device
def _importance_above('''
_RECEIVER = '''@device
def receiver(vertex):
    """(normal, mirror direction, exponent, the Phong lobe's share of what is reflected), each by itself."""
    kd, ks, exponent, chance = vertex.surface
    n, m, glossy = vertex.n, reflect(vertex.wo, vertex.n), average(ks)
    share = select(chance > ZERO, glossy / (average(kd) + glossy), ZERO)
    return n[0], n[1], n[2], m[0], m[1], m[2], exponent, share


@device
def unshadowed_light('''
_KEPT = """\
    to_lobe = receiver(vertex)
    store_front_3(batch.paths, rows.N + 3, at_column, (to_lobe[3], to_lobe[4], to_lobe[5]), alive)
    store_front(batch.paths, rows.N + 6, at_column, to_lobe[6], alive)
    store_front(batch.paths, rows.N + 7, at_column, to_lobe[7], alive)
    if not is_mixed(f):
"""
_LOADED = """
    n = (n[0], n[1], n[2], load(paths, rows.N + 3, i), load(paths, rows.N + 4, i), load(paths, rows.N + 5, i),
         load(paths, rows.N + 6, i), load(paths, rows.N + 7, i))
    return Ray("""
TREE_FOR_GLOSS: Edits = [
    (KERNELS + "rows.py", "_RAY_ROWS = (3, 3, 3, 1, 3, 1, 1)", "_RAY_ROWS = (3, 8, 3, 1, 3, 1, 1)"),
    (
        KERNELS + "light/tree.py",
        "LEAST_COSINE = np.float32(0.2)\n",
        "LEAST_COSINE = np.float32(0.2)\n_LEAST_LOBE = np.float32(0.05)\n",
    ),
    (
        KERNELS + "light/tree.py",
        "from ..jit import device\n",
        "from ..geom.elementary import exp, log_one_minus\nfrom ..jit import device\n",
    ),
    (
        KERNELS + "light/tree.py",
        "_importance_above(node, to, half, height), ZERO)",
        "_importance_above(node, to, half, height) * _lobe_toward(n, to, half), ZERO)",
    ),
    (KERNELS + "light/tree.py", "@device\ndef _importance_above(", _LOBE),
    (KERNELS + "direct.py", "tables.tree, p, n, vertex.own,", "tables.tree, p, receiver(vertex), vertex.own,"),
    (KERNELS + "direct.py", "vec import (\n    BLACK,\n", "vec import (\n    average,\n    reflect,\n    BLACK,\n"),
    (KERNELS + "direct.py", "@device\ndef unshadowed_light(", _RECEIVER),
    (KERNELS + "staged.py", "from .direct import lit_share", "from .direct import receiver, lit_share"),
    (KERNELS + "staged.py", "    if not is_mixed(f):\n", _KEPT),
    (
        KERNELS + "staged.py",
        "straight = light.throughput, ray.p, ray.n,",
        "straight = light.throughput, ray.p, (ray.n[0], ray.n[1], ray.n[2]),",
    ),
    (KERNELS + "batch.py", "\n    return Ray(", _LOADED),
]

# By the kernel that tests compare with. It is imported when it is asked for, as it imports the engine.
_KERNEL_BY_PATH = """\
def tile_kernel(features):
    from tools.by_path import path_kernel

    return path_kernel(features)


def new_batch(features, lamp_count=0):
    from tools.by_path import new_memory

    return new_memory(features, lamp_count)
"""
PATH_BY_PATH: Edits = [("engine/tiles.py", "tile_kernel = cache(make_staged_kernel)\n", _KERNEL_BY_PATH)]

# Two light samples at the first vertex, which share out the samples of a pixel among them. What both find, and the next
# ray, is weighted by twice the density of one: as a ray of half its density is.
_TWO_SHADOW_RAYS = """\
            split, of = np.uint32(1 if stage == 0 else 0), path
            each = Light(BLACK, scale(light.throughput, HALF if stage == 0 else ONE), light.limit)
            for k in range(2 if stage == 0 else 1):
                order = uint32((of.numbers.order >> split) | np.uint32(k << 31))
                numbers = Numbers(of.numbers.key, order, dimension)
                own = Path(of.i, of.place, numbers, of.ray, of.bounces, of.passed, of.light)
                shadows += _queue_shadows(f, tables, batch, own, vertex, each, alive, shadows)
"""
# A path may have two of the sixteen lanes: one after the other adds to its sample.
_ADDED_ONE_BY_ONE = """\
    store_3(batch.shadows, rows.BRINGS, i, select(arrives, brings, BLACK))
    for column in range(i, i + WIDTH):
        for channel in range(3):
            to = batch.shadow_words[rows.TO, column]
            batch.samples[rows.LIGHT + channel, to] += batch.shadows[rows.BRINGS + channel, column]
"""
TWO_LIGHT_SAMPLES: Edits = [
    (
        KERNELS + "rays.py",
        "    add_at_3(batch.samples, rows.LIGHT, place, clamped(f, brings, limit), arrives)\n",
        _ADDED_ONE_BY_ONE,
    ),
    (KERNELS + "rays.py", "    put_at_3,\n", "    put_at_3,\n    store_3,\n"),
    (KERNELS + "rays.py", "from .geom.vec import FAR,", "from .geom.vec import BLACK, FAR,"),
    (
        KERNELS + "staged.py",
        """\
            shadows += _queue_shadows(f, tables, batch, path, vertex, light, alive, shadows)
""",
        _TWO_SHADOW_RAYS,
    ),
    (
        KERNELS + "staged.py",
        "store_front(paths, rows.PDF, at_column, pdf, mask)",
        "store_front(paths, rows.PDF, at_column, pdf * select(path.bounces.total == 0, HALF, ONE), mask)",
    ),
    (KERNELS + "staged.py", "from .geom.vec import BLACK,", "from .geom.vec import HALF, BLACK,"),
    (
        KERNELS + "direct.py",
        "sampled_light_weight(light, pdf)",
        "sampled_light_weight(light, pdf * (HALF if numbers.dimension == FIRST_VERTEX + VERTEX_DECISIONS else ONE))",
    ),
    (
        KERNELS + "direct.py",
        "from .records import LIGHT_CHOICE,",
        "from .records import FIRST_VERTEX, VERTEX_DECISIONS, LIGHT_CHOICE,",
    ),
    (
        KERNELS + "batch.py",
        "_SHAPES = (*((height, COLUMNS) for height in _HEIGHTS), ",
        "_SHAPES = (*((height, COLUMNS) for height in _HEIGHTS[:-1]), (_HEIGHTS[-1], 2 * COLUMNS), ",
    ),
]

# Talbot et al. 2005, "Importance Resampling for Global Illumination": of four light samples one, by what each would
# bring. Weights beside the BRDF's samples are those of one light sample, in both: they add up to 1.
_RESAMPLED = '''@device
def unshadowed_light(f, tables, vertex, numbers):
    """As `_candidate`: one of four."""
    never = vertex.p[0] != vertex.p[0]
    zero = select(never, ONE, ZERO)
    wi, t, pdf, shadowed, found, total = (zero, zero, zero), zero, zero, never, (zero, zero, zero), zero
    u = sample_1d(tables.sampler, numbers.key, numbers.order, numbers.dimension + PASS)
    for k in range(4):
        order = uint32((numbers.order >> np.uint32(2)) | np.uint32(k << 30))
        light, brings = _candidate(f, tables, vertex, Numbers(numbers.key, order, numbers.dimension))
        weight = max_component(brings)
        total = total + weight
        share = select(total > ZERO, weight / total, ZERO)
        taken = u < share
        u = min(select(taken, u / share, (u - share) / (ONE - share)), LAST_BELOW_ONE)
        wi, t, pdf = select(taken, light.wi, wi), select(taken, light.t, t), select(taken, light.pdf, pdf)
        shadowed, found = select(taken, light.shadowed, shadowed), select(taken, brings, found)
    chosen = max_component(found)
    found = scale(found, select(chosen > ZERO, total / (np.float32(4) * chosen), ZERO))
    return LightSample(wi, t, BLACK, pdf, never, shadowed, np.uint32(7)), found


@device
def _candidate(f, tables, vertex, numbers):'''
ONE_OF_FOUR: Edits = [
    (KERNELS + "direct.py", "@device\ndef unshadowed_light(f, tables, vertex, numbers):", _RESAMPLED),
    (
        KERNELS + "direct.py",
        "vec import (\n    BLACK,\n",
        "vec import (\n    LAST_BELOW_ONE,\n    max_component,\n    BLACK,\n",
    ),
    (KERNELS + "direct.py", "emitters import sample_light", "emitters import LightSample, sample_light"),
    (KERNELS + "direct.py", "records import LIGHT_CHOICE,", "records import PASS, Numbers, LIGHT_CHOICE,"),
    (KERNELS + "direct.py", "from .simd import any_of, select", "from .simd import any_of, select, uint32"),
]

MOST_SAMPLES = 512
# How many samples a pixel gets is decided once, by the errors of its neighbours after the first samples and by those of
# all pixels but itself: independent of its own samples, so that its mean stays what it is. On the average half of all.
_BY_NEIGHBOURS = """\
        if not hasattr(self, "wanted"):
            error = np.abs(mean - half).sum(axis=2) / (mean.sum(axis=2) + 0.1)
            around = np.pad(error, 1, mode="reflect")
            height, width = error.shape
            near = sum(around[y : y + height, x : x + width] for y in range(3) for x in range(3) if not x == y == 1) / 8
            others = (error.sum() - error) / max(error.size - 1, 1)
            self.wanted = np.maximum(MIN_SAMPLES, MOST_SAMPLES / 2 * near / np.maximum(others, 1e-12))
        self.active = self.film.samples < self.wanted
"""
SAMPLES_BY_NEIGHBOURS: Edits = [
    (
        "engine/adaptive.py",
        """\
        error = np.abs(mean - half).sum(axis=2) / (1e-4 + np.sqrt(np.maximum(mean.sum(axis=2), 0)))
        self.active &= _with_neighbours(error > self.threshold)
""",
        _BY_NEIGHBOURS,
    ),
    ("engine/adaptive.py", "MIN_SAMPLES = 32", f"MOST_SAMPLES = {MOST_SAMPLES}\nMIN_SAMPLES = 32"),
]
