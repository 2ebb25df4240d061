"""From the names in a scene report to the objects of a view layer that can be selected: those that have it themselves,
and those that place or make what has it, through a collection, particles or geometry nodes.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import bpy

from ..export.notes import Group

SELECTABLE = ("camera", "light", "object", "material", "image")

# What an object is looked up by: ("object", its name), ("material", a name), ("light", a name). Each with its library:
# what is linked from another file may have the same name.
Key = tuple[str, str]


def objects_of(view_layer, depsgraph, groups: Sequence[Group]) -> list[list[bpy.types.Object]]:
    """The objects that each group is about, in the view layer's order. Where an object that is named is in no place of
    its own, what places it counts."""
    index = _index(groups)
    if not index:  # an image that the world alone shows; of instances there may be millions
        return [[] for _ in groups]
    found = _direct(view_layer, index, len(groups))
    of_layer = set(view_layer.objects)
    own = {("object", object_.name_full) for object_ in of_layer}
    for owner, keys in (*_of_collections(view_layer, index), *_of_evaluated(depsgraph, index)):
        for number in _numbers(index, keys - own) if owner in of_layer else ():
            found[number].add(owner)
    return [[object_ for object_ in view_layer.objects if object_ in of_group] for of_group in found]


def may_have_objects(group: Group) -> bool:
    """Whether to offer a button for it: found at once, where `objects_of` may have to look at millions of instances."""
    return any(_keys_of_group(group))


def _index(groups: Sequence[Group]) -> dict[Key, set[int]]:
    """Key -> numbers of the groups that it belongs to."""
    index: dict[Key, set[int]] = {}
    for number, group in enumerate(groups):
        for key in _keys_of_group(group):
            index.setdefault(key, set()).add(number)
    return index


def _keys_of_group(group: Group) -> Iterator[Key]:
    names = set(group.names)
    if group.kind == "image":
        for kind, all_ in (("material", bpy.data.materials), ("light", bpy.data.lights)):
            yield from ((kind, datablock.name_full) for datablock in all_ if _images(datablock.node_tree) & names)
    elif group.kind in SELECTABLE:
        kind = "material" if group.kind == "material" else "object"
        yield from ((kind, name) for name in names)


def _keys(object_) -> set[Key]:
    keys = {("object", object_.name_full)}
    if object_.type == "LIGHT":
        keys.add(("light", object_.data.name_full))
    slots = [slot.material for slot in object_.material_slots]  # of an evaluated object without those that nodes set
    materials = [*slots, *getattr(object_.data, "materials", ())]
    return keys | {("material", material.name_full) for material in materials if material is not None}


def _numbers(index: dict[Key, set[int]], keys: set[Key]) -> set[int]:
    return set().union(*(index[key] for key in keys if key in index))


def _direct(view_layer, index: dict[Key, set[int]], count: int) -> list[set[bpy.types.Object]]:
    """The objects that have it themselves, also those that are hidden in the viewport."""
    found: list[set[bpy.types.Object]] = [set() for _ in range(count)]
    for object_ in view_layer.objects:
        for number in _numbers(index, _keys(object_)):
            found[number].add(object_)
    return found


def _of_collections(view_layer, index) -> Iterator[tuple[bpy.types.Object, set[Key]]]:
    """What places collections, hidden or not, with the keys of what is in them."""
    known: dict[bpy.types.Collection, set[Key]] = {}
    for object_ in view_layer.objects:
        placed = object_.instance_collection if object_.instance_type == "COLLECTION" else None
        if placed is not None and placed not in known:
            known[placed] = set().union(*map(_keys, placed.all_objects)) & index.keys()
        if placed is not None and known[placed]:
            yield object_, known[placed]


def _of_evaluated(depsgraph, index) -> Iterator[tuple[bpy.types.Object, set[Key]]]:
    """What the viewport shows, with the keys that it has after all modifiers."""
    seen = set()
    for item in depsgraph.object_instances:
        object_ = item.object
        # A duplicate's `object` is a stand-in, at one address for all: the datablocks tell them apart.
        one = (object_.data, item.instance_object, item.parent) if item.is_instance else object_
        if one not in seen:
            seen.add(one)
            owner = item.parent if item.is_instance and item.parent else object_
            yield owner.original, _keys(object_) & index.keys()


def _images(tree, seen: frozenset = frozenset()) -> set[str]:
    """The names of the images in a tree and its groups, with their libraries'."""
    if tree is None or tree in seen:
        return set()
    names = {node.image.name_full for node in tree.nodes if getattr(node, "image", None) is not None}
    for node in tree.nodes:
        names |= _images(getattr(node, "node_tree", None), seen | {tree})
    return names
