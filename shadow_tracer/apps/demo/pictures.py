# SPDX-License-Identifier: Apache-2.0
"""The pictures a demo leaves behind: contact sheet, animation frames, single pictures."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

from shadow_tracer.apps.demo.lighting import StageLight

Picture = NDArray[np.uint8]
BACKGROUND = (19, 21, 27)
INK, FAINT = (235, 237, 240), (150, 156, 168)
SHADOW, UNKNOWN = (24, 26, 33), (66, 70, 84)
TILE, GAP, HEADER, CAPTION = (480, 360), 14, 74, 30
# near to far; anchors of a dark-to-light map that also reads in grey
DEPTH_MAP = np.array(
    [[252, 240, 188], [253, 174, 97], [229, 92, 83], [158, 47, 127], [81, 18, 124], [18, 13, 50]], float
)


def mask_picture(mask: Picture, light: StageLight) -> Picture:
    """(H, W, 3) picture of a mask: lit in the light's colour, shadow dark, unknown grey."""
    colour = np.asarray(light.colour) ** (1 / 2.2)
    lit = 255 * (0.25 + 0.75 * colour / colour.max())
    table = np.tile(np.array(UNKNOWN, dtype=np.uint8), (256, 1))
    table[0] = SHADOW
    table[255] = lit.astype(np.uint8)
    return table[mask]


def reach_picture(masks: Mapping[str, Picture], lights: Sequence[StageLight], valid: NDArray[np.bool_]) -> Picture:
    """(H, W, 3) picture of which lights reach each pixel: the sum of their colours, dark where none does."""
    total = np.zeros((*valid.shape, 3))
    for light in lights:
        total += (masks[light.name] == 255)[..., None] * np.asarray(light.colour)
    peak = np.sum([light.colour for light in lights], axis=0).max()
    picture = 255 * np.clip(1.15 * total / peak, 0, 1) ** (1 / 2.2)
    picture = np.where(total.any(axis=-1, keepdims=True), picture, SHADOW)
    return np.asarray(np.where(valid[..., None], picture, UNKNOWN), dtype=np.uint8)


def percent_lit(mask: Picture, depth: NDArray[np.float32]) -> float:
    """How much of the (H, W) pixels with a depth [m] the mask says is lit, 0 to 100."""
    valid = np.isfinite(depth) & (depth > 0)
    return 100 * float((mask == 255)[valid].mean()) if valid.any() else 0.0


def depth_picture(depth: NDArray[np.float32]) -> Picture:
    """(H, W, 3) picture of a depth image in metres: near light, far dark, invalid grey."""
    valid = np.isfinite(depth) & (depth > 0)
    if not valid.any():
        return np.full((*depth.shape, 3), UNKNOWN, dtype=np.uint8)
    low, high = np.percentile(depth[valid], [1, 99])
    place = np.clip((np.where(valid, depth, low) - low) / max(high - low, 1e-6), 0, 1)
    steps = np.linspace(0, 1, len(DEPTH_MAP))
    picture = np.stack([np.interp(place, steps, DEPTH_MAP[:, i]) for i in range(3)], axis=-1)
    return np.asarray(np.where(valid[..., None], picture, UNKNOWN), dtype=np.uint8)


def font(size: int) -> Any:
    """Pillow's own font."""
    return ImageFont.load_default(size)


def fit(picture: Picture, width: int, height: int) -> Image.Image:
    """The picture scaled to fill (width, height), what sticks out cut off evenly."""
    image = Image.fromarray(picture)
    scale = max(width / image.width, height / image.height)
    size = max(width, round(image.width * scale)), max(height, round(image.height * scale))
    if size != image.size:
        image = image.resize(size, Image.Resampling.LANCZOS)
    left, top = (size[0] - width) // 2, (size[1] - height) // 2
    return image.crop((left, top, left + width, top + height))


def panel(
    overlay: Picture, masks: Mapping[str, Picture], lights: Sequence[StageLight], height: int = 360
) -> Image.Image:
    """One frame of the animation: the shaded picture and, beside it, a mask per light."""
    width = round(height * overlay.shape[1] / overlay.shape[0])
    thumb = height // len(lights)
    side = round(thumb * overlay.shape[1] / overlay.shape[0])
    canvas = Image.new("RGB", (width + 2 + side, height), BACKGROUND)
    canvas.paste(fit(overlay, width, height), (0, 0))
    draw = ImageDraw.Draw(canvas)
    for i, light in enumerate(lights):
        top = i * thumb
        canvas.paste(
            fit(mask_picture(masks[light.name], light), side, thumb - 2 * (i + 1 < len(lights))), (width + 2, top)
        )
        _tag(draw, (width + 6, top + 4), light.name, 11)
    return canvas


def _tag(draw: ImageDraw.ImageDraw, at: tuple[int, int], text: str, size: int) -> None:
    """A word on a dark plate."""
    box = draw.textbbox(at, text, font=font(size))
    draw.rounded_rectangle((box[0] - 4, box[1] - 3, box[2] + 4, box[3] + 3), 4, fill=(10, 11, 15))
    draw.text(at, text, font=font(size), fill=INK)


def contact_sheet(
    title: str,
    subtitle: str,
    overlay: Picture,
    depth: NDArray[np.float32],
    masks: Mapping[str, Picture],
    overlays: Mapping[str, Picture],
    lights: Sequence[StageLight],
) -> Image.Image:
    """All about one moment: the scene under all lights, its depth, and per light the mask and the shaded picture.

    Args:
        overlay: (H, W, 3) all lights together.
        depth: (H, W) metres, NaN where invalid.
        masks: light name -> (H, W) mask, overlays: light name -> (H, W, 3) picture under that light alone.
    """
    w, h = TILE
    columns = max(3, len(lights))
    row = h + CAPTION
    size = (columns * (w + GAP) + GAP, HEADER + 4 * row + 3 * GAP)
    sheet = Image.new("RGB", size, BACKGROUND)
    draw = ImageDraw.Draw(sheet)
    draw.text((GAP + 2, 14), title, font=font(28), fill=INK)
    draw.text((GAP + 2, 48), subtitle, font=font(15), fill=FAINT)

    def place(picture: Picture, column: int, top: int, caption: str, span: int = 1, tall: int = h) -> None:
        left, wide = GAP + column * (w + GAP), span * w + (span - 1) * GAP
        sheet.paste(fit(picture, wide, tall), (left, top))
        draw.text((left + 2, top + tall + 6), caption, font=font(15), fill=FAINT)

    y = HEADER
    place(overlay, 0, y, "all lights, shaded with the masks below", 2, 2 * h + CAPTION + GAP)
    place(depth_picture(depth), 2, y, "depth image: near light, far dark, grey no measurement")
    valid = np.isfinite(depth) & (depth > 0)
    place(reach_picture(masks, lights, valid), 2, y + row + GAP, "which lights reach each pixel")
    y += 2 * (row + GAP)
    for i, light in enumerate(lights):
        lit = percent_lit(masks[light.name], depth)
        place(
            mask_picture(masks[light.name], light),
            i,
            y,
            f"mask of {light.name}: {light.kind} light reaches {lit:.0f} %",
        )
        place(overlays[light.name], i, y + row + GAP // 2, f"{light.name} alone")
    return sheet


def save_animation(frames: Sequence[Image.Image], path: Path, durations: Sequence[float]) -> None:
    """An endless GIF of equally large frames with one palette for all.

    Args:
        durations: seconds each frame is shown.

    Raises:
        ValueError: if there are no frames.
    """
    if not frames:
        raise ValueError("frames: must hold at least one picture, got none")
    palette = _palette(frames[:: max(1, len(frames) // 6)])
    small = [frame.quantize(palette=palette, dither=Image.Dither.NONE) for frame in frames]
    times = [10 * round(100 * duration) for duration in durations]
    small[0].save(path, save_all=True, append_images=small[1:], duration=times, loop=0, optimize=False)


def _palette(frames: Sequence[Image.Image]) -> Image.Image:
    """A palette for all frames in which rare colours have their place too, so that no dithering is needed."""
    thinned = [np.asarray(frame)[::3, ::3].reshape(-1, 3) for frame in frames]
    colours = np.concatenate(thinned)
    coarse = (colours >> 3).astype(np.int64) @ np.array([1 << 10, 1 << 5, 1])
    order = np.argsort(coarse, kind="stable")
    _, starts, counts = np.unique(coarse[order], return_index=True, return_counts=True)
    # of n pixels of much the same colour about n^0.6 are counted
    rank = np.arange(len(order)) - np.repeat(starts, counts)
    kept = colours[order[rank < np.repeat(np.ceil(counts**0.6), counts)]]
    return Image.fromarray(kept[None]).quantize(256, Image.Quantize.MEDIANCUT, kmeans=1)
