"""A wood of 10,000 trees on rolling hills, 1.5 million triangles, in a file of a few hundred kilobytes.

Geometry nodes place instances of four tree meshes: a renderer that copies the meshes pays for it here.
"""

from __future__ import annotations

import math

import common as c
import numpy as np

SIDE = 100  # trees per side
SPACING = 1.0
HALF = SIDE * SPACING / 2
FOLIAGE = [(0.09, 0.22, 0.06), (0.16, 0.28, 0.05), (0.45, 0.25, 0.03), (0.36, 0.10, 0.03)]


def height(x, y):
    """The hills, metres."""
    return 3.0 * np.sin(x * 0.09) * np.cos(y * 0.075) + 1.2 * np.sin(x * 0.23 + y * 0.19) + 0.02 * (y + HALF)


def terrain(material):
    n = 64
    axis = np.linspace(-HALF - 15, HALF + 15, n)
    x, y = np.meshgrid(axis, axis)
    vertices = np.stack([x, y, height(x, y)], axis=-1).reshape(-1, 3)
    corner = (np.arange(n - 1)[:, None] * n + np.arange(n - 1)).reshape(-1, 1)
    return c.mesh("Terrain", vertices, corner + [0, 1, n + 1, n], [material], smooth=True)


def tree(name: str, bark, leaves):
    """A trunk and five cones, 156 triangles, 1.9 m tall, with its foot at the origin."""
    rings = [(0.0, 0.06, 0.5, 0.05, 0)]  # z of the base, its radius, z of the top, its radius, material
    rings += [(0.3 + 0.3 * i, 0.52 - 0.085 * i, 0.8 + 0.28 * i, 0.0, 1) for i in range(5)]
    sides = 12
    angle = np.arange(sides) * 2 * math.pi / sides
    circle = np.stack([np.cos(angle), np.sin(angle), np.zeros(sides)], axis=-1)
    vertices, faces, slots = [], [], []
    for low, radius_low, high, radius_high, slot in rings:
        first = len(vertices)
        vertices += [*(circle * radius_low + (0, 0, low)), *(circle * max(radius_high, 0.004) + (0, 0, high))]
        faces += [
            (first + i, first + (i + 1) % sides, first + sides + (i + 1) % sides, first + sides + i)
            for i in range(sides)
        ]
        slots += [slot] * sides
        if slot == 1:  # the underside of the foliage
            faces.append([first + i for i in reversed(range(sides))])
            slots.append(slot)
    return c.mesh(name, vertices, faces, [bark, leaves], slots)


def tree_points():
    """A mesh without faces: one vertex for each tree."""
    rng = np.random.default_rng(5)
    grid = (np.stack(np.meshgrid(np.arange(SIDE), np.arange(SIDE)), axis=-1).reshape(-1, 2) + 0.5) * SPACING - HALF
    xy = grid + rng.uniform(-0.4, 0.4, grid.shape)
    return c.mesh("Places", np.column_stack([xy, height(*xy.T)]), [])


def instancing_nodes(collection):
    """Instance on Points, with the tree, its turn and its size chosen at random."""
    tree_group = c.bpy.data.node_groups.new("Trees", "GeometryNodeTree")
    tree_group.interface.new_socket("Geometry", in_out="INPUT", socket_type="NodeSocketGeometry")
    tree_group.interface.new_socket("Geometry", in_out="OUTPUT", socket_type="NodeSocketGeometry")
    nodes, links = tree_group.nodes, tree_group.links

    def node(kind: str, x: int, y: int):
        made = nodes.new(kind)
        made.location = (x, y)
        return made

    source, sink = node("NodeGroupInput", -600, 200), node("NodeGroupOutput", 300, 200)
    scatter = node("GeometryNodeInstanceOnPoints", 0, 200)
    trees = node("GeometryNodeCollectionInfo", -300, 0)
    trees.inputs["Collection"].default_value = collection
    trees.inputs["Separate Children"].default_value = True
    trees.inputs["Reset Children"].default_value = True
    scatter.inputs["Pick Instance"].default_value = True
    turn, size = node("FunctionNodeRandomValue", -300, -200), node("FunctionNodeRandomValue", -300, -420)
    turn.data_type = "FLOAT_VECTOR"
    turn.inputs["Min"].default_value, turn.inputs["Max"].default_value = (-0.06, -0.06, 0), (0.06, 0.06, math.tau)
    size.data_type = "FLOAT"
    shown(size.inputs, "Min").default_value, shown(size.inputs, "Max").default_value = 0.6, 1.5
    links.new(source.outputs[0], scatter.inputs["Points"])
    links.new(trees.outputs[0], scatter.inputs["Instance"])
    links.new(turn.outputs["Value"], scatter.inputs["Rotation"])
    links.new(shown(size.outputs, "Value"), scatter.inputs["Scale"])
    links.new(scatter.outputs["Instances"], sink.inputs[0])
    return tree_group


def shown(sockets, name: str):
    """The one that the node's data type uses: until Blender 5.1 there is one of this name for each type."""
    return next(socket for socket in sockets if socket.name == name and socket.enabled)


def build() -> None:
    scene = c.new_file(768, 512, samples=64, view_transform="AgX")
    trees = c.bpy.data.collections.new("Tree kinds")  # not linked to the scene: seen only through instances
    bark = c.diffuse("Bark", (0.12, 0.07, 0.04))
    for number, color in enumerate(FOLIAGE):
        name = f"Tree {number}"
        c.add_object(name, tree(name, bark, c.diffuse(f"Leaves {number}", color)), collection=trees)

    wood = c.add_object("Wood", tree_points())
    wood.modifiers.new("Trees", "NODES").node_group = instancing_nodes(trees)
    c.add_object("Terrain", terrain(c.diffuse("Grass", (0.16, 0.15, 0.06))))
    c.lamp("Sun", "SUN", (-40, -20, 35), (0, 0, 0), energy=4.0, angle=math.radians(1), color=(1, 0.85, 0.65))
    c.set_background(scene.world, (0.35, 0.5, 0.8), 0.8)
    c.camera(scene, (0, -62, 13), (0, -15, 0.5), lens=35)


if __name__ == "__main__":
    build()
    c.save("instances")
