# SPDX-License-Identifier: Apache-2.0
"""Pictures of the light grid for docs/light_grid.md: tiles over a depth image and in the light's coordinates, tests per
ray, and tests per pixel of a rendered depth image.

Takes the real depth image of a living room where the data folder is present, and the demo's workshop always.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
from pictures import Picture, demo_workshop, heat, living_room
from pictures_counts import PackedTiles, Traced, angle_tiles, evenly, packed_tiles, trace, trace_pixels
from PIL import Image, ImageDraw

from shadow_tracer import State

_FACES = ("+U", "-U", "+V", "-V", "+W", "-W")
_AXES = (("V", "W"), ("V", "W"), ("W", "U"), ("W", "U"), ("U", "V"), ("U", "V"))
_GAP, _TITLE, _NOTE = 12, 30, 24
_INK, _PAPER, _NOTHING = (25, 25, 25), (255, 255, 255), (28, 28, 28)
# Left upper corner of the detail, and its size.
_DETAIL = {"livingroom": (440, 240), "workshop": (200, 150)}
_DETAIL_SIZE = 80, 60


def _font(draw: ImageDraw.ImageDraw, at: tuple[float, float], text: str, size: int, anchor: str = "la") -> None:
    draw.text(at, text, fill=_INK, font_size=size, anchor=anchor)


def _panel(picture: Image.Image, title: str, note: str = "") -> Image.Image:
    """A picture with a title above and a note below."""
    out = Image.new("RGB", (picture.width, picture.height + _TITLE + (_NOTE if note else 0)), _PAPER)
    draw = ImageDraw.Draw(out)
    _font(draw, (0, 3), title, 20)
    out.paste(picture, (0, _TITLE))
    _font(draw, (0, _TITLE + picture.height + 4), note, 16)
    return out


def _sheet(rows: list[list[Image.Image]]) -> Image.Image:
    widths = [max(row[k].width for row in rows if k < len(row)) for k in range(max(map(len, rows)))]
    heights = [max(panel.height for panel in row) for row in rows]
    size = sum(widths) + _GAP * (len(widths) + 1), sum(heights) + _GAP * (len(heights) + 1)
    out = Image.new("RGB", size, _PAPER)
    y = _GAP
    for row, height in zip(rows, heights, strict=True):
        x = _GAP
        for panel, width in zip(row, widths, strict=False):
            out.paste(panel, (x, y))
            x += width + _GAP
        y += height + _GAP
    return out


def _save(sheet: Image.Image, path: Path, colors: int) -> None:
    sheet.quantize(colors, dither=Image.Dither.NONE).save(path, optimize=True)
    print(f"{path.name}: {sheet.width} x {sheet.height}, {path.stat().st_size // 1000} kB")


def _tints(hue: np.ndarray, shade: np.ndarray) -> np.ndarray:
    """Twelve hues that differ most between neighbours, four shades."""
    hsv = np.empty((*hue.shape, 3), np.uint8)
    hsv[..., 0] = hue * 5 % 12 * 21
    hsv[..., 1] = np.array([110, 140, 90, 150], np.uint8)[shade % 4]
    hsv[..., 2] = np.array([255, 175, 215, 135], np.uint8)[shade % 4]
    return np.asarray(Image.fromarray(hsv.reshape(-1, 1, 3), "HSV").convert("RGB")).reshape(hsv.shape)


def _bar(width: int, most: float) -> Image.Image:
    """What the colours of a heat map mean: square roots from 0 to ``most``."""
    out = Image.new("RGB", (width, 38), _PAPER)
    draw = ImageDraw.Draw(out)
    last = width - 60
    out.paste(Image.fromarray(_levels(np.linspace(0.0, most, last)[None].repeat(14, axis=0), most)), (0, 4))
    free = 0.0
    for value in (0, 1, 2, 5, 10, 20, 50, 100, 200, 500, 1000, 2000, 5000):
        x = last * (value / most) ** 0.5
        if free <= x <= last - 40:
            draw.line((x, 18, x, 22), fill=_INK)
            _font(draw, (max(x, 5), 24), str(value), 14, "mt")
            free = x + 32
    draw.line((last - 1, 18, last - 1, 22), fill=_INK)
    _font(draw, (last, 24), f"{most:.0f} or more", 14, "mt")
    return out


def _levels(values: np.ndarray, most: float) -> np.ndarray:
    return heat(np.round(np.clip(values / most, 0.0, 1.0) ** 0.5 * 24) / 24)


def _heat_panel(values: np.ndarray, most: float, title: str, note: str) -> Image.Image:
    """A heat map with its scale."""
    picture = Image.fromarray(_levels(values, most))
    bar = _bar(picture.width, most)
    both = Image.new("RGB", (picture.width, picture.height + bar.height), _PAPER)
    both.paste(picture, (0, 0))
    both.paste(bar, (0, picture.height))
    return _panel(both, title, note)


def _tile_colors(packed: PackedTiles) -> np.ndarray:
    """(T + 1, 3): the last one is for pixels without a tile."""
    of = _tints(packed.column + 3 * packed.group, packed.place)
    return np.concatenate([of, np.array([_NOTHING], np.uint8)])


def _rectangles(
    packed: PackedTiles, group: int, window: np.ndarray, size: tuple[int, int], rays: np.ndarray | None = None
) -> Image.Image:
    """Tile rectangles of a group within a window u0, u1, v0, v1; with (N, 2) rays, their outlines and those rays."""
    scale = min(size[0] / (window[1] - window[0]), size[1] / (window[3] - window[2]))
    middle = 0.5 * (window[0] + window[1]), 0.5 * (window[2] + window[3])
    colors = _tile_colors(packed)
    out = Image.new("RGB", size, _NOTHING)
    draw = ImageDraw.Draw(out)

    def at(u: np.ndarray, v: np.ndarray) -> np.ndarray:
        return np.stack([0.5 * size[0] + (u - middle[0]) * scale, 0.5 * size[1] - (v - middle[1]) * scale], axis=-1)

    for tile in np.flatnonzero((packed.group == group) & (packed.rays > 0)):
        u0, u1, v0, v1 = packed.box[tile]
        low, high = at(u0, v1), at(u1, v0)
        if (low < size).all() and (high > 0).all():
            fill = tuple(int(x) for x in colors[tile])
            draw.rectangle((*low, *np.maximum(high, low)), fill=fill, outline=None if rays is None else _INK)
    if rays is not None:
        for x, y in at(rays[:, 0], rays[:, 1]):
            draw.rectangle((x - 1, y - 1, x, y), fill=_INK)
    return out


def _light_side(packed: PackedTiles) -> Image.Image:
    """All rectangles: the group with the most rays large, the others small beside it."""
    out = Image.new("RGB", (640, 480), _PAPER)
    draw = ImageDraw.Draw(out)
    groups = np.argsort(-packed.rays_of_group, kind="stable")[: np.count_nonzero(packed.rays_of_group)]
    large = (640, 456) if len(groups) == 1 else (470, 456)
    side = min(150, (480 - 24 * (len(groups) - 1)) // max(1, len(groups) - 1))
    for k, group in enumerate(groups):
        window = packed.extent[group] if packed.aligned else np.array((-1.0, 1.0, -1.0, 1.0))
        name = "frustum around +W" if packed.aligned else f"face {_FACES[group]}"
        text = f"{name}: {packed.rays_of_group[group]:,} rays"
        x, y, size = (0, 0, large) if k == 0 else (640 - side, (k - 1) * (side + 24), (side, side))
        out.paste(_rectangles(packed, group, window, size), (x, y))
        _font(draw, (x, y + size[1] + 3), text, 16 if k == 0 else 13)
    return out


def _angle_row(spherical: Traced) -> list[Image.Image]:
    """Tiles of ``spherical`` over the image, and how many rays they have."""
    angles = angle_tiles(spherical)
    row, column = np.divmod(angles.tile_of, angles.columns)
    pixels = np.where((angles.tile_of >= 0)[..., None], _tints(column, row), np.array(_NOTHING, np.uint8))
    grid = angles.rays.reshape(-1, angles.columns)[::-1]
    side = min(640 / angles.width, 430 / angles.height)
    size = max(1, round(angles.width * side)), max(1, round(angles.height * side))
    cells = Image.fromarray(_levels(grid, 100.0)).resize(size, Image.Resampling.NEAREST)
    light = Image.new("RGB", (640, 480), _PAPER)
    light.paste(cells, (0, 0))
    light.paste(_bar(640, 100.0), (0, size[1] + 2))
    width, height = np.degrees((angles.width, angles.height))
    used = angles.rays > 0
    note = f"{used.sum():,} tiles with rays, up to {angles.rays.max():,} in one; {angles.items:,} work items"
    note += f" of at most {spherical.pipeline.rays.threshold}"
    share = (
        f"{width:.0f} x {height:.0f} degrees, {len(grid)} rows of {angles.columns}; {1 - used.mean():.0%} without rays"
    )
    title = "spherical: rays of its tiles, azimuth to the right, elevation up"
    return [
        _panel(Image.fromarray(pixels), "spherical: pixels in the colour of their tile", note),
        _panel(light, title, share),
    ]


def draw_tiles(picture: Picture, traced: Traced, spherical: Traced, out: Path) -> None:
    """Write ``light_grid_tiles_<name>.png``."""
    packed = packed_tiles(traced)
    pixels = _tile_colors(packed)[packed.tile_of]
    x, y = _DETAIL[picture.name]
    width, height = _DETAIL_SIZE
    inside = np.s_[y : y + height, x : x + width]
    whole = Image.fromarray(pixels)
    ImageDraw.Draw(whole).rectangle((x - 2, y - 2, x + width + 1, y + height + 1), outline=_PAPER, width=2)
    close = Image.fromarray(pixels[inside]).resize((640, 480), Image.Resampling.NEAREST)
    seen = packed.tile_of[inside]
    group = int(np.bincount(packed.group[seen[seen >= 0]], minlength=6).argmax())
    rays = packed.uv[inside][(seen >= 0) & (packed.group[seen] == group)]
    low, high = np.quantile(rays, (0.02, 0.98), axis=0)
    window = np.array((low[0], high[0], low[1], high[1]))
    full, short = int((packed.rays == 32).sum()), int(((packed.rays > 0) & (packed.rays < 32)).sum())
    columns = len(np.unique(packed.group[packed.rays > 0] * 65536 + packed.column[packed.rays > 0]))
    empty, most = evenly(packed)
    note = f"{full:,} tiles of 32 rays, {short} with fewer, in {columns} columns"
    even = f"As many cells of equal size: {empty:.0%} would be without rays, one would have {most:,}"
    light = "packed: the same tiles as rectangles in (u, v)"
    where = "the frustum" if packed.aligned else f"face {_FACES[group]}"
    close_light = f"The detail's part of {where}; dots: rays of its pixels"
    sheet = _sheet(
        [
            [
                _panel(whole, "packed: pixels in the colour of their tile", note),
                _panel(_light_side(packed), light, even),
            ],
            [
                _panel(close, "packed: the detail in the white frame"),
                _panel(_rectangles(packed, group, window, (640, 480), rays), close_light),
            ],
            _angle_row(spherical),
        ]
    )
    _save(sheet, out / f"light_grid_tiles_{picture.name}.png", 96)


def draw_tests(picture: Picture, packed: Traced, spherical: Traced, out: Path) -> None:
    """Write ``light_grid_tests_<name>.png``."""
    state = packed.frame.state("lamp")
    mask = np.array([255, 90, 90, 28], np.uint8)[state]
    rays = int((state != State.INVALID).sum())
    shadow = (
        f"{(state == State.SHADOWED).sum() / rays:.0%} in shadow; {len(picture.triangles):,} triangles, {rays:,} rays"
    )
    bins, tiles = packed.pipeline._way._bins, packed_tiles(packed)
    entries = np.where(tiles.tile_of >= 0, bins.total.numpy()[tiles.tile_of], 0)
    most = float(np.ceil(np.percentile(entries, 99.5) / 10) * 10)

    def note(traced: Traced, counted: np.ndarray) -> str:
        counters = traced.frame.counters
        entries = f"entries {counters['entries']:,}, largest tile {counters['largest_tile']:,}"
        return f"mean {counted[state != State.INVALID].mean():.1f}; {entries}"

    sheet = _sheet(
        [
            [
                _panel(
                    Image.fromarray(mask).convert("RGB"), "Mask (lit, in shadow, no depth: white, grey, black)", shadow
                ),
                _heat_panel(entries, most, "packed: triangles in the list of a ray's tile", note(packed, entries)),
            ],
            [
                _heat_panel(packed.tests, most, "packed: tests of each ray", note(packed, packed.tests)),
                _heat_panel(spherical.tests, most, "spherical: tests of each ray", note(spherical, spherical.tests)),
            ],
        ]
    )
    _save(sheet, out / f"light_grid_tests_{picture.name}.png", 64)


def draw_depth(picture: Picture, out: Path) -> None:
    """Write ``light_grid_depth_<name>.png``."""
    seen, indirect = trace_pixels(picture, 8)
    other, direct = trace_pixels(picture, 16)
    assert (seen.triangle == other.triangle).all() and (seen.depth.view(np.int32) == other.depth.view(np.int32)).all()
    shape = picture.depth.shape
    depth, triangle = seen.depth.reshape(shape), seen.triangle.reshape(shape)
    nearest, farthest = np.nanpercentile(depth, (0.5, 99.5))
    gray = np.clip((farthest - np.nan_to_num(depth, nan=1e9)) / (farthest - nearest), 0.0, 1.0)
    gray = np.where(np.isnan(depth), 0.0, 0.15 + 0.85 * gray)
    levels = Image.fromarray((255 * np.round(gray * 48) / 48).astype(np.uint8)).convert("RGB")
    patches = np.where(triangle[..., None] >= 0, _tints(triangle * 7, triangle), np.array(_NOTHING, np.uint8))
    most = float(np.ceil(np.percentile(direct, 99.5) / 10) * 10)
    sheet = _sheet(
        [
            [
                _panel(levels, "Depth", f"{nearest:.1f} m (white) to {farthest:.1f} m"),
                _panel(
                    Image.fromarray(patches.astype(np.uint8)),
                    "Triangle",
                    f"{len(np.unique(triangle[triangle >= 0])):,} of {len(picture.triangles):,} are seen",
                ),
            ],
            [
                _heat_panel(
                    direct,
                    most,
                    "Tests of each pixel: tiles of 16 x 16",
                    f"direct mapping: mean {direct.mean():.0f}, most {direct.max():,}",
                ),
                _heat_panel(
                    indirect,
                    most,
                    "Tests of each pixel: tiles of 8 x 8",
                    f"indirect mapping: mean {indirect.mean():.0f}, most {indirect.max():,}",
                ),
            ],
        ]
    )
    _save(sheet, out / f"light_grid_depth_{picture.name}.png", 96)


def main() -> None:
    """Draw all pictures there is data for."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=Path("docs/images"))
    options = parser.parse_args()
    for picture in (living_room(), demo_workshop()):
        if picture is not None:
            packed = trace(picture, "packed")
            spherical = trace(picture, "spherical")
            draw_tiles(picture, packed, spherical, options.out)
            draw_tests(picture, packed, spherical, options.out)
            draw_depth(picture, options.out)


if __name__ == "__main__":
    main()
