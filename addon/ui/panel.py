"""What Lobe's own panels share."""

from __future__ import annotations

from .compat import ENGINE


class LobePanel:
    bl_space_type = "PROPERTIES"
    bl_region_type = "WINDOW"
    COMPAT_ENGINES = {ENGINE}

    @classmethod
    def poll(cls, context) -> bool:
        return context.engine in cls.COMPAT_ENGINES

    def column(self, align: bool = False, dots: bool = False):
        """A column in the two-part layout of Blender's own properties; `dots` to set keyframes with, where Blender's
        own panel of the same has them."""
        layout = self.layout
        layout.use_property_split = True
        layout.use_property_decorate = dots
        return layout.column(align=align)
