# SPDX-License-Identifier: Apache-2.0
"""What the light grid did, ray by ray, for pictures: the trace kernels again, counting in the place of answering. The
counts must add up to the frame's own counter.

As a program it prints the counts in docs/light_grid.md.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import nullcontext
from dataclasses import dataclass
from typing import Any

import numpy as np
import procedural
import warp as wp
from pictures import Picture, demo_workshop, living_room
from report import table

from shadow_tracer import Bounds, DepthCamera, Frame, PointLight, Scene, ShadowTracer, SpotLight
from shadow_tracer.gpu.accelerators.camera_grid.grid import Grid
from shadow_tracer.gpu.accelerators.camera_grid.hit import Sorted, tile_may_meet
from shadow_tracer.gpu.accelerators.camera_grid.primary import PrimaryRays
from shadow_tracer.gpu.accelerators.light_grid.binning import Bins
from shadow_tracer.gpu.accelerators.light_grid.tiles import Tiles
from shadow_tracer.gpu.accelerators.spherical_grid.rays import Tiles as AngleTiles
from shadow_tracer.gpu.accelerators.spherical_grid.rays import cell_of
from shadow_tracer.gpu.device import forms
from shadow_tracer.gpu.device.devices import pick_device
from shadow_tracer.gpu.exact.decision import YES, filter_pair, ray_magnitude
from shadow_tracer.gpu.visibility.depth_image import Seen


@wp.kernel(enable_backward=False)
def count_packed(tiles: Tiles, bins: Bins, records: wp.array2d(dtype=wp.vec4), tests: wp.array(dtype=int)):
    """Tests of each ray in the entries of its tile. One thread per lane."""
    lane = wp.tid()
    tile = lane // 32
    if ((tiles.live[tile] >> (lane & 31)) & 1) == 0:
        return
    base = (lane >> 4) * 80 + (lane & 15)
    ray = wp.vec4(tiles.rays[base], tiles.rays[base + 16], tiles.rays[base + 32], tiles.rays[base + 48])
    k = bins.start[tile]
    end = k + bins.length[tile]
    done = int(0)
    while k < end:
        answer = filter_pair(ray, tiles.rays[base + 64], records, bins.sorted[k])
        done += 1
        k += 1
        if answer == YES:
            k = end
    tests[tiles.order[lane]] = done


@wp.kernel(enable_backward=False)
def count_spherical(
    absent: int,
    rays: wp.array(dtype=wp.vec4),
    polar: wp.array(dtype=wp.vec3),
    ray_keys: wp.array(dtype=int),
    order: wp.array(dtype=int),
    tiles: AngleTiles,
    begins: wp.array(dtype=int),
    entry_keys: wp.array(dtype=int),
    entry_values: wp.array(dtype=int),
    records: wp.array2d(dtype=wp.vec4),
    tests: wp.array(dtype=int),
):
    """The same for the spherical grid. One thread per ray in sorted order."""
    j = wp.tid()
    tile = ray_keys[j]
    if tile == absent:
        return
    grid = tiles.grid[0]
    i = order[j]
    magnitude = ray_magnitude(rays[i])
    last = tile * grid.cells + cell_of(grid, polar[i][2])
    e = begins[tile]
    end = begins[tile + 1]
    done = int(0)
    while e < end and entry_keys[e] <= last:
        answer = filter_pair(rays[i], magnitude, records, entry_values[e])
        done += 1
        e += 1
        if answer == YES:
            e = end
    tests[i] = done


@wp.kernel(enable_backward=False)
def count_pixels(grid: Grid, scene: Sorted, tests: wp.array(dtype=int)):
    """Triangles that the pixels of each sorting tile are tested with. One thread per tile."""
    tile = wp.tid()
    tile_y = tile // grid.tiles_x
    tile_x = tile - tile_y * grid.tiles_x
    coarse = grid.tiles_x * grid.tiles_y + (tile_y // grid.group) * grid.coarse_x + tile_x // grid.group
    done = scene.starts[tile + 1] - scene.starts[tile]
    for k in range(scene.starts[coarse], scene.starts[coarse + 1]):
        if tile_may_meet(scene.lists[k], tile_x, tile_y, grid, scene.seen.records):
            done += 1
    tests[tile] = done


def _agree(mine: int, counter: int) -> None:
    if mine != counter:
        raise SystemExit(f"the picture counts {mine} tests, the frame {counter}")


@dataclass(frozen=True)
class Traced:
    """A frame, and what its grid was. ``tests`` by pixel."""

    frame: Frame
    pipeline: Any
    tests: np.ndarray


def _frame(picture: Picture, variant: str, light: procedural.Light, bias: float) -> tuple[Frame, Any]:
    """A frame, and the pipeline that has traced it."""
    triangles, rays = len(picture.triangles), picture.depth.size
    tracer = ShadowTracer("light_grid", variant, "cpu", Bounds(max_triangles=triangles, max_rays=rays, max_lights=1))
    tracer.scene.put("scene", picture.vertices, picture.triangles)
    frame = tracer.trace(picture.depth, picture.camera, [light], bias)
    engine: Any = tracer._engine.inside
    return frame, engine._bands[0].pipeline


def trace(picture: Picture, variant: str) -> Traced:
    """A frame with tests counted by pixel; ``variant`` is packed or spherical. Only what CUDA does has all entries of
    packed in its lists at once."""
    with forms.cuda_form() if variant == "packed" else nullcontext():
        return _count(picture, variant)


def _count(picture: Picture, variant: str) -> Traced:
    count = picture.depth.size
    frame, pipeline = _frame(picture, variant, PointLight("lamp", picture.light), 0.02)
    context = pipeline._context
    tests, records = wp.zeros(count, dtype=int, device="cpu"), context.records.of(0)
    if variant == "spherical":
        of, lists = pipeline.rays, pipeline.lists
        inputs = [of.tile_count, context.samples.rays, of.polar, of.keys, of.order, of.tiles]
        inputs += [lists.begins, lists.keys, lists.values, records, tests]
        wp.launch(count_spherical, dim=count, inputs=inputs, device="cpu")
    else:
        tiles = pipeline._buffers.tiles
        lanes = 512 * int(tiles.counts.numpy()[2])
        wp.launch(count_packed, dim=lanes, inputs=[tiles, pipeline._way._bins, records, tests], device="cpu")
    found = tests.numpy()
    _agree(int(found.sum()), frame.counters["leaf_tests"])
    return Traced(frame, pipeline, found.reshape(picture.depth.shape))


@dataclass(frozen=True)
class PackedTiles:
    """Tiles of ``packed``, in order: (T,) rays, group, column in the group, place in the column; (T, 4) rectangles u0,
    u1, v0, v1; (6,) rays and (6, 4) extents u0, u1, v0, v1 of each group; (H, W) tile of each pixel, -1 where there is
    none; (H, W, 2) its (u, v); whether there is one frustum instead of six faces."""

    rays: np.ndarray
    group: np.ndarray
    column: np.ndarray
    place: np.ndarray
    box: np.ndarray
    rays_of_group: np.ndarray
    extent: np.ndarray
    tile_of: np.ndarray
    uv: np.ndarray
    aligned: bool


def packed_tiles(traced: Traced) -> PackedTiles:
    """The tiles of a frame that ``packed`` has traced."""
    tiles = traced.pipeline._buffers.tiles
    groups, count = tiles.groups.numpy()[:6], 16 * int(tiles.counts.numpy()[2])
    number = np.arange(count)
    rays, group, column, place = (np.zeros(count, int) for _ in range(4))
    for k, (_, of, length, _, _, first_block) in enumerate(groups):
        own = (number >= 16 * first_block) & (number < 16 * (first_block + -(-of // 512)))
        at = number[own] - 16 * first_block
        group[own], column[own], place[own] = k, at // (length // 32), at % (length // 32)
        rays[own] = np.clip(of - 32 * at, 0, 32)
    boxes = tiles.boxes.numpy()[: 6 * count].reshape(-1, 6, 16).transpose(0, 2, 1).reshape(-1, 6)
    box = np.stack([boxes[:, 0] - boxes[:, 2], boxes[:, 0] + boxes[:, 2], boxes[:, 1] - boxes[:, 3]], axis=1)
    box = np.column_stack([box, boxes[:, 1] + boxes[:, 3]])
    lanes = np.flatnonzero(np.arange(32)[None] < rays[:, None])
    pixels = tiles.order.numpy()[lanes]
    tile_of, uv = np.full(traced.tests.size, -1), np.zeros((traced.tests.size, 2))
    tile_of[pixels] = lanes // 32
    h = tiles.rays.numpy()[: 160 * count].reshape(-1, 5, 16).transpose(0, 2, 1).reshape(-1, 5)[lanes]
    axis = group[lanes // 32] // 2
    along = np.abs(h[np.arange(len(h)), axis])
    for k in range(2):
        uv[pixels, k] = h[np.arange(len(h)), (axis + 1 + k) % 3] / along
    fit = tiles.fit.numpy()[:6].astype(float)
    size = np.divide(4096.0, fit[:, 2:], out=np.zeros((6, 2)), where=fit[:, 2:] > 0.0)
    extent = np.column_stack([fit[:, 0], fit[:, 0] + size[:, 0], fit[:, 1], fit[:, 1] + size[:, 1]])
    shape = traced.tests.shape
    aligned = bool(tiles.aligned.numpy()[0])
    at = tile_of.reshape(shape), uv.reshape(*shape, 2)
    return PackedTiles(rays, group, column, place, box, groups[:, 1], extent, *at, aligned)


def evenly(packed: PackedTiles) -> tuple[float, int]:
    """Were the same rectangles cut into about as many cells of equal size: the share of cells without a ray, and the
    most rays of a cell."""
    size = (packed.extent[:, 1] - packed.extent[:, 0]) * (packed.extent[:, 3] - packed.extent[:, 2])
    side = np.sqrt(size.sum() / np.count_nonzero(packed.rays))
    cells = []
    group = np.where(packed.tile_of >= 0, packed.group[packed.tile_of], -1)
    for k in np.flatnonzero(packed.rays_of_group):
        u0, u1, v0, v1 = packed.extent[k]
        bins = max(1, round((u1 - u0) / side)), max(1, round((v1 - v0) / side))
        u, v = packed.uv[group == k].T
        cells.append(np.histogram2d(u, v, bins, ((u0, u1), (v0, v1)))[0].ravel())
    rays = np.concatenate(cells)
    return float((rays == 0).mean()), int(rays.max())


@dataclass(frozen=True)
class AngularTiles:
    """Tiles of ``spherical``: (T,) rays; columns of the grid; its width and height [rad]; (H, W) tile of each pixel, -1
    where there is none; work items."""

    rays: np.ndarray
    columns: int
    width: float
    height: float
    tile_of: np.ndarray
    items: int


def angle_tiles(traced: Traced) -> AngularTiles:
    """The tiles of a frame that ``spherical`` has traced."""
    of = traced.pipeline.rays
    grid = of.tiles.grid.numpy()[0]
    columns, rows = int(grid["columns"]), int(grid["rows"])
    keys, order = of.keys.numpy()[: traced.tests.size], of.order.numpy()[: traced.tests.size]
    there = keys != of.tile_count
    tile_of = np.full(traced.tests.size, -1)
    tile_of[order[there]] = keys[there]
    rays = np.bincount(keys[there], minlength=columns * rows)
    size = columns / float(grid["columns_per_radian"]), rows / float(grid["rows_per_radian"])
    return AngularTiles(rays, columns, *size, tile_of.reshape(traced.tests.shape), int(of.counts.numpy()[0]))


def trace_pixels(picture: Picture, tile: int) -> tuple[Seen, np.ndarray]:
    """The picture's mesh as its camera sees it, with sorting tiles of so many pixels; and tests by pixel."""
    scene, camera = Scene(), picture.camera
    scene.put("scene", picture.vertices, picture.triangles)
    bounds = Bounds(max_triangles=len(picture.triangles), max_rays=picture.depth.size)
    primary = PrimaryRays(pick_device("cpu"), bounds, wide=False, tile=tile)
    seen = primary.render(scene, camera)
    grid = primary._grid
    tests = wp.zeros(grid.tiles_x * grid.tiles_y, dtype=int, device="cpu")
    sorted_triangles = primary._sorted(primary._tile_starts())
    wp.launch(count_pixels, dim=len(tests), inputs=[grid, sorted_triangles, tests], device="cpu")
    of_tile = tests.numpy().reshape(grid.tiles_y, grid.tiles_x)
    found = of_tile.repeat(tile, axis=0).repeat(tile, axis=1)[: camera.height, : camera.width]
    _agree(int(found.sum()), seen.counters["tests"])
    return seen, found


def _views() -> Iterator[tuple[str, Picture, procedural.Light, float]]:
    """Name, what is seen, light and bias."""
    room, hall = living_room(), demo_workshop()
    if room is not None:
        yield "living room", room, PointLight("lamp", room.light), 0.02
    yield "workshop", hall, PointLight("lamp", hall.light), 0.02
    for degrees in (30, 15, 5):
        way = hall.camera.camera_to_world[:3, 2]
        yield f"workshop, spot {degrees}", hall, SpotLight("lamp", hall.light, way, math.radians(degrees)), 0.02
    made = procedural.stadium()
    scene = Scene()
    scene.put("scene", made.positions[0], made.triangles)
    for eye, light in (("pot", "inside"), ("pot", "outside"), ("stand", "outside")):
        camera, name = made.eyes[eye].camera(256), f"stadium, {eye}, {light}"
        depth, _ = DepthCamera("cpu", Bounds(max_triangles=len(made.triangles), max_rays=65536)).render(scene, camera)
        depth[~made.eyes[eye].pixels(256)] = np.nan
        where = np.array(made.lights[light].position)
        yield (
            name,
            Picture(name, scene["scene"].vertices, made.triangles, depth, camera, where),
            made.lights[light],
            0.01,
        )


def main() -> None:
    """Print the counts."""
    rows: list[dict[str, Any]] = []
    for name, picture, light, bias in _views():
        for variant, as_on_cuda in (("packed", False), ("packed", True), ("spherical", False)):
            with forms.cuda_form() if as_on_cuda else nullcontext():
                counters = _frame(picture, variant, light, bias)[0].counters
            row: dict[str, Any] = {"view": name, "variant": f"{variant}, as on CUDA" if as_on_cuda else variant}
            row |= {key: counters[key] for key in ("triangles", "rays", "entries")}
            row["tests per ray"] = counters["leaf_tests"] / counters["rays"]
            rows.append(row | {key: counters[key] for key in ("largest_tile", "accepted", "splits")})
    table(rows)


if __name__ == "__main__":
    main()
