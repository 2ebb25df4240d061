"""The shader editor's sidebar, where those who edit nodes find the settings of what the nodes belong to. Its panels are
copies of those of the properties, as Cycles and EEVEE have them of theirs."""

from __future__ import annotations

from bl_ui.space_node import node_panel

from . import data_panels, material_panels, world_panels

# A copy isn't derived from its panel: `super()` doesn't work in these classes themselves, but in their bases.
CLASSES = tuple(
    node_panel(panel)
    for panel in (
        data_panels.LOBE_LIGHT_PT_light,
        data_panels.LOBE_LIGHT_PT_beam_shape,
        world_panels.LOBE_WORLD_PT_ray_visibility,
        material_panels.LOBE_MATERIAL_PT_settings,
    )
)
