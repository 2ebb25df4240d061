"""From the names in a scene report to the objects of a view layer that can be selected."""

from __future__ import annotations

from collections.abc import Callable

import bpy

from ..export.notes import Group

SELECTABLE = ("camera", "light", "object", "material", "image")


def objects_of(view_layer, group: Group) -> list[bpy.types.Object]:
    """The objects that a group is about, in the view layer's order.

    Of those that it only holds as instances, what instances them.
    """
    wanted = _wanted(group)
    if wanted is None:
        return []
    direct = [object_ for object_ in view_layer.objects if wanted(object_)]
    if group.kind in ("material", "image"):
        missing = None
    else:
        missing = set(group.names) - {object_.name for object_ in direct}
    instancers = [o for o in view_layer.objects if o not in direct and _instances_any(o, wanted, missing)]
    return direct + instancers


def _wanted(group: Group) -> Callable | None:
    names = set(group.names)
    if group.kind in ("camera", "light", "object"):
        return lambda object_: object_.name in names
    if group.kind == "material":
        return lambda object_: any(material.name_full in names for material in _materials(object_))
    if group.kind == "image":
        using = {material for material in bpy.data.materials if _images(material.node_tree) & names}
        return lambda object_: any(material in using for material in _materials(object_))
    return None


def _instances_any(object_, wanted: Callable, missing: set[str] | None) -> bool:
    """missing  names that are looked for; None: whatever is wanted"""
    collection = object_.instance_collection
    if object_.instance_type != "COLLECTION" or collection is None or missing == set():
        return False
    return any(wanted(inner) and (missing is None or inner.name in missing) for inner in collection.all_objects)


def _materials(object_) -> list[bpy.types.Material]:
    return [slot.material for slot in object_.material_slots if slot.material is not None]


def _images(tree, seen: frozenset = frozenset()) -> set[str]:
    """The names of the images in a tree and its groups."""
    if tree is None or tree in seen:
        return set()
    names = {node.image.name for node in tree.nodes if getattr(node, "image", None) is not None}
    for node in tree.nodes:
        names |= _images(getattr(node, "node_tree", None), seen | {tree})
    return names
