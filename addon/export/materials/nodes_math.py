"""Value nodes that compute with numbers and vectors: Math, Vector Math, Clamp, Map Range, Separate, Combine and turns.

Divisions by zero and roots of negative numbers give 0, as in Cycles (util/math.h, the safe_ functions).
"""

from __future__ import annotations

import numpy as np

from .tree import Slot
from .values import Evaluator, as_color, value_node


def safe_divide(a, b):
    b = np.asarray(b, np.float64)
    return np.where(b == 0.0, 0.0, a / np.where(b == 0.0, 1.0, b))


def safe_power(a, b):
    """a^b; 0 where a is negative and b not a whole number."""
    a, b = np.broadcast_arrays(np.asarray(a, np.float64), np.asarray(b, np.float64))
    whole = b == np.floor(b)
    with np.errstate(all="ignore"):
        return np.nan_to_num(np.where((a >= 0.0) | whole, np.power(a, b), 0.0), nan=0.0, posinf=0.0, neginf=0.0)


def safe_log(a, b):
    good = (a > 0.0) & (b > 0.0)
    return np.where(good, safe_divide(np.log(np.where(good, a, 1.0)), np.log(np.where(good, b, np.e))), 0.0)


def safe_modulo(a, b):
    return np.where(b == 0.0, 0.0, np.fmod(a, np.where(b == 0.0, 1.0, b)))


def floored_modulo(a, b):
    return np.where(b == 0.0, 0.0, np.mod(a, np.where(b == 0.0, 1.0, b)))


def smooth_minimum(a, b, c):
    """The polynomial smooth minimum that Blender uses (Inigo Quilez, "Smooth minimum", cubic)."""
    overlap = np.where(c == 0.0, 0.0, np.maximum(c - np.abs(a - b), 0.0) / np.where(c == 0.0, 1.0, c))
    return np.minimum(a, b) - overlap**3 * c / 6.0


def wrap(a, b, c):
    """`a` brought into the range from `c` to `b`."""
    span = b - c
    return np.where(span == 0.0, c, a - span * np.floor(safe_divide(a - c, span)))


def ping_pong(a, b):
    scaled = safe_divide(a - b, 2.0 * b)
    return np.where(b == 0.0, 0.0, np.abs((scaled - np.floor(scaled)) * b * 2.0 - b))


MATH = {
    "ADD": lambda a, b, c: a + b,
    "SUBTRACT": lambda a, b, c: a - b,
    "MULTIPLY": lambda a, b, c: a * b,
    "DIVIDE": lambda a, b, c: safe_divide(a, b),
    "MULTIPLY_ADD": lambda a, b, c: a * b + c,
    "POWER": lambda a, b, c: safe_power(a, b),
    "LOGARITHM": lambda a, b, c: safe_log(a, b),
    "SQRT": lambda a, b, c: np.sqrt(np.maximum(a, 0.0)),
    "INVERSE_SQRT": lambda a, b, c: safe_divide(1.0, np.sqrt(np.maximum(a, 0.0))),
    "ABSOLUTE": lambda a, b, c: np.abs(a),
    "EXPONENT": lambda a, b, c: np.exp(np.minimum(a, 88.0)),
    "MINIMUM": lambda a, b, c: np.minimum(a, b),
    "MAXIMUM": lambda a, b, c: np.maximum(a, b),
    "LESS_THAN": lambda a, b, c: (a < b).astype(np.float64),
    "GREATER_THAN": lambda a, b, c: (a > b).astype(np.float64),
    "SIGN": lambda a, b, c: np.sign(a),
    "COMPARE": lambda a, b, c: (np.abs(a - b) <= np.maximum(c, 1e-5)).astype(np.float64),
    "SMOOTH_MIN": smooth_minimum,
    "SMOOTH_MAX": lambda a, b, c: -smooth_minimum(-a, -b, c),
    "ROUND": lambda a, b, c: np.floor(a + 0.5),
    "FLOOR": lambda a, b, c: np.floor(a),
    "CEIL": lambda a, b, c: np.ceil(a),
    "TRUNC": lambda a, b, c: np.trunc(a),
    "FRACT": lambda a, b, c: a - np.floor(a),
    "MODULO": lambda a, b, c: safe_modulo(a, b),
    "FLOORED_MODULO": lambda a, b, c: floored_modulo(a, b),
    "WRAP": wrap,
    "SNAP": lambda a, b, c: np.floor(safe_divide(a, b)) * b,
    "PINGPONG": lambda a, b, c: ping_pong(a, b),
    "SINE": lambda a, b, c: np.sin(a),
    "COSINE": lambda a, b, c: np.cos(a),
    "TANGENT": lambda a, b, c: np.tan(a),
    "ARCSINE": lambda a, b, c: np.arcsin(np.clip(a, -1.0, 1.0)),
    "ARCCOSINE": lambda a, b, c: np.arccos(np.clip(a, -1.0, 1.0)),
    "ARCTANGENT": lambda a, b, c: np.arctan(a),
    "ARCTAN2": lambda a, b, c: np.arctan2(a, b),
    "SINH": lambda a, b, c: np.sinh(np.clip(a, -88.0, 88.0)),
    "COSH": lambda a, b, c: np.cosh(np.clip(a, -88.0, 88.0)),
    "TANH": lambda a, b, c: np.tanh(a),
    "RADIANS": lambda a, b, c: np.radians(a),
    "DEGREES": lambda a, b, c: np.degrees(a),
}


@value_node("ShaderNodeMath")
def math(evaluator: Evaluator, slot: Slot) -> np.ndarray | None:
    operation = MATH.get(slot.node.operation)
    if operation is None:
        return None
    value = operation(*(evaluator.array(slot.input(name)) for name in ("Value", "Value_001", "Value_002")))
    return np.clip(value, 0.0, 1.0) if slot.node.use_clamp else value


def dot(a, b) -> np.ndarray:
    return (a * b).sum(axis=-1, keepdims=True)


def length(a) -> np.ndarray:
    return np.sqrt(dot(a, a))


# Operations of Math that Vector Math applies to each component, and its own; `s` is the Scale input.
COMPONENTWISE = (
    *("ADD", "SUBTRACT", "MULTIPLY", "DIVIDE", "MULTIPLY_ADD", "POWER", "ABSOLUTE", "MINIMUM", "MAXIMUM", "SIGN"),
    *("FLOOR", "CEIL", "MODULO", "WRAP", "SNAP", "SINE", "COSINE", "TANGENT"),
)


def _componentwise(operation):
    return lambda a, b, c, s: operation(a, b, c)


VECTOR_MATH = {
    **{name: _componentwise(MATH[name]) for name in COMPONENTWISE},
    "FRACTION": lambda a, b, c, s: a - np.floor(a),
    "CROSS_PRODUCT": lambda a, b, c, s: np.cross(a, b),
    "PROJECT": lambda a, b, c, s: b * safe_divide(dot(a, b), dot(b, b)),
    "REFLECT": lambda a, b, c, s: a - 2.0 * safe_divide(b, length(b)) * dot(a, safe_divide(b, length(b))),
    "FACEFORWARD": lambda a, b, c, s: np.where(dot(c, b) < 0.0, a, -a),
    "DOT_PRODUCT": lambda a, b, c, s: dot(a, b),
    "DISTANCE": lambda a, b, c, s: length(a - b),
    "LENGTH": lambda a, b, c, s: length(a),
    "SCALE": lambda a, b, c, s: a * s,
    "NORMALIZE": lambda a, b, c, s: safe_divide(a, length(a)),
}


@value_node("ShaderNodeVectorMath")
def vector_math(evaluator: Evaluator, slot: Slot) -> np.ndarray | None:
    operation = VECTOR_MATH.get(slot.node.operation)
    if operation is None:
        return None
    vectors = [evaluator.vector(slot.input(name)) for name in ("Vector", "Vector_001", "Vector_002")]
    return operation(*vectors, evaluator.array(slot.input("Scale"), 1.0))


@value_node("ShaderNodeClamp")
def clamp(evaluator: Evaluator, slot: Slot) -> np.ndarray:
    value, low, high = (evaluator.array(slot.input(name)) for name in ("Value", "Min", "Max"))
    if slot.node.clamp_type == "RANGE":
        low, high = np.minimum(low, high), np.maximum(low, high)
    return np.minimum(np.maximum(value, low), high)


def smoothstep(t):
    t = np.clip(t, 0.0, 1.0)
    return t * t * (3.0 - 2.0 * t)


def smootherstep(t):
    t = np.clip(t, 0.0, 1.0)
    return t**3 * (t * (t * 6.0 - 15.0) + 10.0)


MAP_SHAPES = {"LINEAR": lambda t: t, "SMOOTHSTEP": smoothstep, "SMOOTHERSTEP": smootherstep}


@value_node("ShaderNodeMapRange")
def map_range(evaluator: Evaluator, slot: Slot) -> np.ndarray:
    node = slot.node
    names = ("From Min", "From Max", "To Min", "To Max", "Steps")
    if node.data_type == "FLOAT_VECTOR":
        value = evaluator.vector(slot.input("Vector"))
        names = [name.replace(" ", "_") + "_FLOAT3" for name in names]
        low, high, to_low, to_high, steps = (evaluator.vector(slot.input(name)) for name in names)
    else:
        value = evaluator.array(slot.input("Value"))
        low, high, to_low, to_high, steps = (evaluator.array(slot.input(name)) for name in names)
    t = safe_divide(value - low, high - low)
    if node.interpolation_type == "STEPPED":
        t = np.where(steps > 0.0, np.floor(t * (steps + 1.0)) / np.where(steps > 0.0, steps, 1.0), 0.0)
    else:
        t = MAP_SHAPES[node.interpolation_type](t)
    result = to_low + t * (to_high - to_low)
    if node.clamp:
        result = np.clip(result, np.minimum(to_low, to_high), np.maximum(to_low, to_high))
    return result


@value_node("ShaderNodeCombineXYZ")
def combine_xyz(evaluator: Evaluator, slot: Slot) -> np.ndarray:
    return stack(*(evaluator.array(slot.input(name)) for name in "XYZ"))


@value_node("ShaderNodeSeparateXYZ")
def separate_xyz(evaluator: Evaluator, slot: Slot) -> np.ndarray:
    index = "XYZ".index(slot.socket.identifier)
    return as_color(evaluator.value(slot.input("Vector")))[..., index : index + 1]


def stack(*channels: np.ndarray) -> np.ndarray:
    """(..., 3) of three (..., 1)."""
    return np.concatenate(np.broadcast_arrays(*channels), axis=-1)


@value_node("ShaderNodeMapping")
def mapping(evaluator: Evaluator, slot: Slot) -> np.ndarray:
    """Cycles, kernel/svm/mapping_util.h."""
    vector, location, scale = (evaluator.vector(slot.input(name)) for name in ("Vector", "Location", "Scale"))
    turn = euler_matrix(evaluator.mean_vector(slot.input("Rotation")))
    kind = slot.node.vector_type
    if kind == "TEXTURE":
        return safe_divide((vector - location) @ turn, scale)
    if kind == "NORMAL":
        turned = safe_divide(vector, scale) @ turn.T
        return safe_divide(turned, length(turned))
    turned = (vector * scale) @ turn.T
    return turned + location if kind == "POINT" else turned


def euler_matrix(angles: np.ndarray) -> np.ndarray:
    """(3, 3) rotation by XYZ Euler angles in radians: about x first, then y, then z, as Blender's default order."""
    (cx, cy, cz), (sx, sy, sz) = np.cos(angles), np.sin(angles)
    about_x = np.array([[1, 0, 0], [0, cx, -sx], [0, sx, cx]])
    about_y = np.array([[cy, 0, sy], [0, 1, 0], [-sy, 0, cy]])
    about_z = np.array([[cz, -sz, 0], [sz, cz, 0], [0, 0, 1]])
    return about_z @ about_y @ about_x


TURNS_ABOUT = {"X_AXIS": (1.0, 0.0, 0.0), "Y_AXIS": (0.0, 1.0, 0.0), "Z_AXIS": (0.0, 0.0, 1.0)}


@value_node("ShaderNodeVectorRotate")
def vector_rotate(evaluator: Evaluator, slot: Slot) -> np.ndarray:
    """Cycles, kernel/svm/vector_rotate.h."""
    center = evaluator.vector(slot.input("Center"))
    return (evaluator.vector(slot.input("Vector")) - center) @ turn_of(evaluator, slot).T + center


def turn_of(evaluator: Evaluator, slot: Slot) -> np.ndarray:
    """(3, 3) that a Vector Rotate node turns by."""
    node = slot.node
    if node.rotation_type == "EULER_XYZ":
        turn = euler_matrix(evaluator.mean_vector(slot.input("Rotation")))
    else:
        axis = TURNS_ABOUT.get(node.rotation_type)
        axis = evaluator.mean_vector(slot.input("Axis")) if axis is None else np.array(axis)
        turn = axis_matrix(axis, evaluator.number(slot.input("Angle")))
    return turn.T if node.invert else turn


def axis_matrix(axis: np.ndarray, angle: float) -> np.ndarray:
    """(3, 3) rotation by radians about an axis of any length, by Rodrigues' formula; none about one of length zero."""
    x, y, z = safe_divide(axis, np.linalg.norm(axis))
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return np.eye(3) + np.sin(angle) * cross + (1.0 - np.cos(angle)) * cross @ cross
