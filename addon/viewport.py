"""The viewport in Rendered mode. For now it says in words that Lobe doesn't render there yet."""

from __future__ import annotations

import blf

TEXT_SIZE = 16.0  # pixels


def draw_message(region, text: str) -> None:
    """Write `text` into the middle of the region."""
    blf.size(0, TEXT_SIZE)
    width, height = blf.dimensions(0, text)
    blf.color(0, 0.8, 0.8, 0.8, 1.0)
    blf.position(0, (region.width - width) / 2.0, (region.height - height) / 2.0, 0.0)
    blf.draw(0, text)
