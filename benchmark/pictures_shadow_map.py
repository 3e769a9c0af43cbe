# SPDX-License-Identifier: Apache-2.0
"""Draws docs/images/shadow_map.png: an exact mask, that of a shadow map, and the pixels in which they differ.

The map is a cube of 1024 x 1024 texels around the light of the street of ``procedural.py``, with the bias of
``shadow_map.BIASES`` that gives it the fewest wrong pixels.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
from case import Case
from PIL import Image, ImageDraw
from report import ROOT
from scenes import procedural_view
from shadow_map import masks, rasteriser

from shadow_tracer.apps.demo import pictures

_LIT, _DARK, _WRONG, _NOTHING = (245, 222, 179), (44, 52, 70), (213, 40, 0), (255, 255, 255)
_GAP, _LINE = 8, 26


def main() -> None:
    """Draw it."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--size", type=int, default=400, help="width and height of each of the three images [px]")
    parser.add_argument("--map", type=int, default=1024, help="width and height of the maps [texels]")
    parser.add_argument("--out", type=Path, default=ROOT / "docs" / "images", help="folder")
    options = parser.parse_args()
    view = procedural_view("robots", "corridor", "inside", options.size, frames=2)
    case = Case(view, 1)
    frame, right = case.frames[0], case.static[0][0]
    drawer, _ = rasteriser(view.positions[0], view.triangles)
    found = min(
        masks(drawer, view.light, frame.points, view.bias, options.map).values(), key=lambda mask: (mask != right).sum()
    )
    wrong = found != right
    images = []
    for mask in (right, found, found):
        image = np.full((options.size * options.size, 3), _NOTHING, np.uint8)
        image[frame.valid] = np.where(mask[:, None], _DARK, _LIT)
        images.append(image)
    images[2][frame.valid] = np.where(wrong[:, None], _WRONG, 255 - (255 - images[2][frame.valid]) // 4)
    titles = (
        "exact",
        f"shadow map, {options.map} x {options.map} x 6",
        f"different: {100 * wrong.mean():.1f} % of the pixels",
    )
    sheet = Image.new("RGB", (3 * options.size + 2 * _GAP, options.size + _LINE), "white")
    draw = ImageDraw.Draw(sheet)
    for place, (image, title) in enumerate(zip(images, titles, strict=True)):
        left = place * (options.size + _GAP)
        sheet.paste(Image.fromarray(image.reshape(options.size, options.size, 3)), (left, _LINE))
        draw.text((left + 2, 4), title, fill=(34, 34, 34), font=pictures.font(15))
    path = options.out / "shadow_map.png"
    sheet.quantize(16).save(path, optimize=True)
    print(path, path.stat().st_size)


if __name__ == "__main__":
    main()
