# SPDX-License-Identifier: Apache-2.0
"""The tiles of `light_grid`'s variant `packed`, alone and as numpy arrays."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import probe
import probe_accelerators
import warp as wp

from shadow_tracer import Bounds, PointLight, ShadowTracer
from shadow_tracer.gpu.accelerators.admission import IN_TREE
from shadow_tracer.gpu.accelerators.interface import Rays
from shadow_tracer.gpu.accelerators.light_grid.pack_pieces import begin_light
from shadow_tracer.gpu.accelerators.light_grid.pieces import Pieces
from shadow_tracer.gpu.accelerators.light_grid.tiles import LOOKUP, QUANTITIES, Tiles
from shadow_tracer.gpu.device import native
from shadow_tracer.gpu.exact.light_frame import SHADOWED, Anchor, LightFrame, make_anchor, make_light_frame
from shadow_tracer.gpu.exact.light_space import space_of
from shadow_tracer.gpu.samples.sample_set import SampleSet
from shadow_tracer.scene.lights import Light

TILE, BLOCK = 32, 512  # rays
LEVELS = ("tile", "block", "column")
# At distance 1 from samples around the origin with scale 1, the depth of light space is 1/|h| for the first, Z/|h| for
# the others.
NEAR = PointLight("near", (0.0, 0.0, 0.5))
OUTSIDE = PointLight("outside", (0.0, 0.0, 3.0))


@dataclass(frozen=True)
class Boxes:
    """Boxes of one level, (B,) each: `number` of the box among those of its level, `group`, and the number of its
    `column` within the group; `low` and `high` (B, 3) in (u, v, t), float64."""

    number: np.ndarray
    group: np.ndarray
    column: np.ndarray
    low: np.ndarray
    high: np.ndarray


@dataclass(frozen=True)
class Packed:
    """What is in `Tiles`, read back. G groups, N tiles; `pieces`: made of pieces, as the wide form does."""

    pieces: bool
    aligned: np.ndarray  # (lights,)
    fit: np.ndarray  # (G, 4)
    groups: np.ndarray  # (G, 6) see tiles.py
    counts: np.ndarray  # (3,)
    order: np.ndarray  # (N, 32) rays of the lanes
    live: np.ndarray  # (N, 32) bool
    rays: np.ndarray  # (N, 32, 5); of pieces (N, 32, 4)
    magnitudes: np.ndarray  # (N, 2) of pieces: the most of a tile's lanes, and with |W|; infinity if each has its own
    lookup: np.ndarray  # (G, 256, 2)
    boxes: dict[str, Boxes]  # by level, without places that hold no rays
    empty: dict[str, np.ndarray]  # by level, (E, 2): half extents of the places that hold none

    @property
    def tile_of_ray(self) -> dict[int, int]:
        """Tile of every ray that is in one."""
        tiles, lanes = np.nonzero(self.live)
        return dict(zip(self.order[tiles, lanes].tolist(), tiles.tolist(), strict=True))

    def places(self) -> dict[str, np.ndarray]:
        """(N,) by level: number of the box that each tile that holds rays is in."""
        tiles = self.boxes["tile"]
        columns = self.groups[tiles.group, 3] + tiles.column
        block_in_column = (
            tiles.number // 16 - self.groups[tiles.group, 5] - tiles.column * (self.groups[tiles.group, 2] // BLOCK)
        )
        return {"tile": tiles.number, "block": 16 * columns + block_in_column, "column": columns}


def _boxes(values: np.ndarray, number: np.ndarray, group: np.ndarray, column: np.ndarray) -> Boxes:
    """`values` (sixteens, 6, 16) as in the buffer."""
    box = values[number // 16, :, number % 16].astype(np.float64)
    low = np.column_stack([box[:, 0] - box[:, 2], box[:, 1] - box[:, 3], box[:, 4]])
    high = np.column_stack([box[:, 0] + box[:, 2], box[:, 1] + box[:, 3], box[:, 5]])
    return Boxes(number, group, column, low, high)


def read(tiles: Tiles) -> Packed:
    """Read back the tiles of a pass."""
    counts = tiles.counts.numpy().copy()
    groups = tiles.groups.numpy()[: 6 * tiles.lights].copy()
    count = 16 * int(counts[2])
    pieces = tiles.source.shape[0] > 0
    lanes, order = np.arange(count), tiles.order.numpy()
    if pieces:
        lanes, piece = tiles.source.numpy()[:count].T
        _, first, more = tiles.numbers.numpy()[piece].T
        order = (order[first[:, None] + np.arange(TILE)] + more[:, None]).reshape(-1)
    halves = tiles.rays.numpy().reshape(-1, 2, 4 if pieces else 5, 16)[lanes]
    live = (tiles.live.numpy()[:count, None].view(np.uint32) >> np.arange(TILE, dtype=np.uint32)) & 1
    sixteens = {
        level: values.numpy().reshape(-1, QUANTITIES, 16)
        for level, values in zip(LEVELS, (tiles.boxes, tiles.blocks, tiles.columns), strict=True)
    }
    most = tiles.magnitudes.numpy()[lanes] if pieces else np.empty((0, 2), np.float32)
    # number, group, column of each place that is to hold rays, by level
    full: dict[str, list[tuple[int, int, int]]] = {level: [] for level in LEVELS}
    for group, (_, rays, length, column, columns, block) in enumerate(groups.tolist()):
        for k in range(columns):
            full["column"].append((column + k, group, k))
            inside = min(length, rays - k * length)
            for b in range(-(-inside // BLOCK)):
                full["block"].append((16 * (column + k) + b, group, k))
            first = 16 * (block + k * (length // BLOCK))
            full["tile"] += [(first + tile, group, k) for tile in range(-(-inside // TILE))]
    boxes, empty = {}, {}
    ends = {"tile": count, "block": 16 * int(counts[1]), "column": int(counts[1])}
    for level in LEVELS:
        number, group_of, column_of = np.array(full[level], int).reshape(-1, 3).T
        boxes[level] = _boxes(sixteens[level], number, group_of, column_of)
        some = np.setdiff1d(np.arange(ends[level]), number)
        if level == "block":  # those of places without a column are never asked for
            some = some[np.isin(some // 16, np.array(full["column"], int).reshape(-1, 3)[:, 0])]
        empty[level] = sixteens[level][some // 16, 2:4, some % 16]
    return Packed(
        pieces,
        tiles.aligned.numpy()[: tiles.lights].copy(),
        tiles.fit.numpy()[: 6 * tiles.lights].copy(),
        groups,
        counts,
        order[: TILE * count].reshape(count, TILE).copy(),
        live.astype(bool),
        halves.transpose(0, 1, 3, 2).reshape(count, TILE, 4 if pieces else 5).copy(),
        np.where(np.isinf(most[:, :1]), np.float32(np.inf), most),
        tiles.lookup.numpy()[: 6 * LOOKUP * tiles.lights].reshape(-1, LOOKUP, 2).copy(),
        boxes,
        empty,
    )


def most_of(rays: np.ndarray, some: np.ndarray) -> np.ndarray:
    """(N, 2) the largest magnitude of ``some`` of (N, 32, 4) rays, and with |W|, as float32 has them."""
    with np.errstate(invalid="ignore"):
        x, y, w, z = np.moveaxis(np.abs(rays), -1, 0)
        magnitude = x + y + z + np.float32(2.0**-20)
    return np.stack([np.where(some, each, 0).max(axis=1) for each in (magnitude, magnitude + w)], axis=-1)


@native.func_native("accelerators/light_grid/pieces16.h", calls="Pieces16::more")
def more_pieces(place: int, inverse: bool, first: int, end: int, tiles: Tiles, pieces: Pieces):
    """The pieces from `first` on are there."""
    ...


@wp.kernel(enable_backward=False, module="unique")
def begin_pieces(tiles: Tiles, pieces: Pieces):
    begin_light(wp.tid(), tiles, pieces)


@wp.kernel(enable_backward=False, module="unique")
def measure_pieces(lights: wp.array(dtype=LightFrame), tiles: Tiles, pieces: Pieces):
    place = wp.tid()
    first = place * pieces.of_light
    more_pieces(place, space_of(lights[place]).inverse != 0, first, first + pieces.of_light, tiles, pieces)


def _fill(pieces: Pieces, tiles: Tiles, samples: SampleSet, group: np.ndarray, lights: int) -> None:
    """What projecting leaves of rays, groups and states."""
    wp.launch(begin_pieces, dim=lights, inputs=[tiles, pieces], device="cpu")
    count = lights * pieces.of_light
    lanes, first, more = tiles.numbers.numpy()[:count].T
    sample = tiles.order.numpy()[first[:, None] + np.arange(32)]
    there = (sample > 0) | (first[:, None] + np.arange(32) == 0)
    number = sample + more[:, None]
    inside = (group == IN_TREE)[number] & there
    inside &= samples.states_of(0, lights).numpy()[number] != SHADOWED
    halves = tiles.rays.numpy().reshape(-1, 2, 4, 16)
    ray = samples.rays.numpy()[number].reshape(count, 2, 16, 4)
    halves[lanes] = ray.transpose(0, 1, 3, 2)
    tiles.magnitudes.numpy()[lanes] = most_of(ray.reshape(count, TILE, 4), inside)
    bits = (inside.astype(np.uint64) << np.arange(32, dtype=np.uint64)).sum(axis=1)
    pieces.live.numpy()[:count] = bits.astype(np.uint32).view(np.int32)
    wp.launch(measure_pieces, dim=lights, inputs=[samples.lights_from(0), tiles, pieces], device="cpu")


class Packing:
    """Packs any rays, without a scene."""

    def __init__(self, device: str, max_rays: int, max_lights: int = 1) -> None:
        self._tracer = ShadowTracer("light_grid", "packed", device, Bounds(1, max_rays, max_lights, 1, 1), threads=1)

    def pack(
        self,
        rays: np.ndarray,
        kind: np.ndarray | None = None,
        states: np.ndarray | None = None,
        lights: tuple[Light, ...] = (OUTSIDE,),
        width: int = 0,
    ) -> Packed:
        """(lights, N, 4) rays in light space; (lights, N) group (all in tiles) and states (all lit); `width`: of the
        image they are of, 0 if of points."""
        frame, pipeline = probe.context(self._tracer).samples, probe.pipeline(self._tracer)
        rays = np.ascontiguousarray(rays, np.float32).reshape(len(lights), -1, 4)
        count, everything = rays.shape[1], rays.shape[0] * rays.shape[1]
        frames = tuple(make_light_frame(light, Anchor((0.0, 0.0, 0.0), 1.0), k) for k, light in enumerate(lights))
        frame.set_samples(count, width)
        frame.set_lights(frames)
        group = probe_accelerators.admission_groups(pipeline)
        frame.rays[:everything].assign(rays.reshape(-1, 4))
        group[:everything].assign(np.ones(everything, np.uint8) if kind is None else kind.reshape(-1))
        frame.states_of(0, len(lights)).assign(np.zeros(everything, np.uint8) if states is None else states.reshape(-1))
        rays_of = Rays(frames)
        pieces = probe_accelerators.begin(pipeline, rays_of)
        if pieces is not None:
            _fill(pieces, probe_accelerators.tiles(pipeline), frame, group.numpy(), len(lights))
        return read(probe_accelerators.pack(pipeline, rays_of))


# --- scenes that need the pads: 32 samples, each 32 times so that the boxes of its tile hold but one direction ---

Scene = tuple[Light, float, np.ndarray, np.ndarray]
_LAMP = PointLight("lamp", (0.125, -0.25, 0.375))


def beside_the_light(rng: np.random.Generator) -> Scene:
    """Triangles 2^-40 m from the light, whose edges float64 coordinates hardly tell, and samples in directions exactly
    on an edge of each, or 2^-20 to 2^-14 beside it."""
    corners = rng.integers(-8, 9, (32, 3, 3)).astype(float)
    weights = rng.integers(1, 8, (32, 2)).astype(float)
    ways = weights[:, :1] * corners[:, 0] + weights[:, 1:] * corners[:, 1]
    aside = rng.choice([-1.0, 0.0, 0.0, 1.0], (32, 1)) * 2.0 ** rng.integers(-20, -14, (32, 1))
    ways += aside * (corners[:, 2] - corners[:, 0])
    return _LAMP, 0.0, np.repeat(_LAMP.position + ways / 32.0, 32, axis=0), _LAMP.position + 2.0**-40 * corners


def vast(rng: np.random.Generator) -> Scene:
    """Triangles of 2^40 m whose planes go exactly through a point each, and a sample just behind or before it."""
    points = rng.integers(-128, 129, (32, 3)) / 64.0
    spans = rng.integers(-8, 9, (32, 2, 3)).astype(float)
    corners = points[:, None] + 2.0**37 * np.stack([spans[:, 0], spans[:, 1], -spans[:, 0] - spans[:, 1]], axis=1)
    steps = rng.choice([-1.0, 1.0, 1.0], (32, 1)) * 2.0 ** rng.integers(-34, -12, (32, 1))
    return _LAMP, 0.0, np.repeat(points + steps * (points - _LAMP.position), 32, axis=0), corners


def between_faces(rng: np.random.Generator) -> Scene:
    """Rays so near to where two cube faces meet that roundings decide about theirs, each just within a triangle that
    lies on one of them."""
    limits = np.array([(-4.0, -4.0, -4.0), (4.0, 4.0, 4.0)])
    frame = make_light_frame(_LAMP, make_anchor(np.zeros(3), float(np.linalg.norm(limits[1])), None))
    axes = np.stack([np.array(frame.r), np.array(frame.s), -np.array(frame.f)])
    ways = np.column_stack([np.ones(30), 1.0 + 10.0 ** rng.uniform(-9.0, -7.0, 30), rng.uniform(-1.0, 1.0, 30)])
    corners = ways[:, None] + rng.uniform(0.1, 0.3, (30, 3, 1)) * [(0.0, 0.0, 0.0), (-1.0, 0.0, 1.0), (-1.0, 0.0, -1.0)]
    corners[:, 0] -= 1e-12 * (corners[:, 1] + corners[:, 2] - 2.0 * ways)
    turns = np.argsort(rng.random((30, 3)), axis=1)
    signs = rng.choice([-1.0, 1.0], (30, 3))
    ways = np.take_along_axis(ways, turns, axis=1) * signs
    corners = np.take_along_axis(corners, turns[:, None], axis=2) * signs[:, None]
    corners *= rng.uniform(0.1, 0.5, (30, 1, 1))
    points = _LAMP.position + rng.uniform(0.8, 2.0, (30, 1)) * (ways @ axes)
    return _LAMP, 0.0, np.repeat(np.concatenate([limits, points]), 32, axis=0), _LAMP.position + corners @ axes


def at_corners(rng: np.random.Generator) -> Scene:
    """Samples less than 1e-10 behind the corner of a triangle that is nearest to the light, from outside."""
    lamp = PointLight("lamp", (8.0, 6.0, -8.0))
    nearest = rng.uniform(-2.0, 2.0, (32, 3))
    away = nearest - lamp.position
    away /= np.linalg.norm(away, axis=1, keepdims=True)
    spans = rng.normal(size=(32, 2, 3)) * 0.2 + rng.uniform(0.3, 0.6, (32, 2, 1)) * away[:, None]
    corners = np.stack([nearest, nearest + spans[:, 0], nearest + spans[:, 1]], axis=1)
    points = nearest + 1e-12 * (spans[:, 0] + spans[:, 1]) + 1e-11 * away
    return lamp, 0.0, np.repeat(points, 32, axis=0), corners


def near_the_light(rng: np.random.Generator) -> Scene:
    """Samples within 0.1 mm of the light, among others metres away, just behind or before a triangle each."""
    ways = rng.integers(-128, 129, (30, 3)) * 2.0**-21
    spans = rng.integers(-8, 9, (30, 2, 3)) * 2.0**-17
    corners = np.stack([spans[:, 0], spans[:, 1], -spans[:, 0] - spans[:, 1]], axis=1)
    steps = rng.choice([-1.0, 1.0, 1.0], (30, 1)) * 2.0 ** rng.integers(-18, -5, (30, 1))
    points = _LAMP.position + np.concatenate([[(-3.0, -2.0, -1.0), (2.0, 3.0, 1.0)], ways + steps * ways])
    return _LAMP, 0.0, np.repeat(points, 32, axis=0), _LAMP.position + ways[:, None] + corners


HARD: dict[str, Callable[[np.random.Generator], Scene]] = {
    "beside the light": beside_the_light,
    "vast": vast,
    "between faces": between_faces,
    "at corners": at_corners,
    "near the light": near_the_light,
}
