"""How the node group `Phong BSDF` is known, for all that ask: the export, the panels, and Cycles as Lobe's peer.

Nothing is registered for it, so that it can be asked without the add-on.
"""

from __future__ import annotations

PHONG_GROUP_NAME = "Phong BSDF"
PHONG_MARK = "lobe_phong"  # custom property by which the group is known even when it has been renamed
PHONG_INPUTS = frozenset(("kd", "ks", "exponent"))


def is_phong_tree(tree) -> bool:
    """Whether a node tree, or None, is such a group, whose nodes' inputs are all that Lobe reads of it.

    A mark or the name alone doesn't make it one: without one of the inputs it is the user's own, like any other group.
    """
    if tree is None or tree.bl_idname != "ShaderNodeTree":
        return False
    if PHONG_MARK not in tree and tree.name != PHONG_GROUP_NAME:
        return False
    sockets = (item for item in tree.interface.items_tree if item.item_type == "SOCKET")
    return {socket.name for socket in sockets if socket.in_out == "INPUT"} >= PHONG_INPUTS
