# SPDX-License-Identifier: Apache-2.0
"""Pieces of samples, in the form of the CPU: each sample is in one of them, rays are those that other pipelines get,
and whatever is split, taken apart or made of them, every ray that takes part is in one tile, whose box holds it."""

from __future__ import annotations

from typing import Any

import geometry
import numpy as np
import packed_grid
import probe
import probe_accelerators
import pytest

from shadow_tracer import Bounds, Camera, DirectionalLight, PointLight, ShadowTracer, SpotLight
from shadow_tracer.gpu.accelerators.light_grid.pieces import most_pieces, samples_of, shape_of
from shadow_tracer.gpu.exact.light_frame import make_light_frame
from shadow_tracer.scene.lights import Light

pytestmark = pytest.mark.wide

_SHAPES = [
    (1, 0),
    (33, 0),
    (4096, 0),
    (1, 1),
    (64 * 48, 64),
    (65 * 47, 65),
    (700 * 3, 700),
    (3 * 700, 3),
    (257 * 9, 257),
]


@pytest.mark.parametrize("count, width", _SHAPES)
def test_every_sample_is_in_one_piece(count: int, width: int) -> None:
    rows, across = shape_of(count, width)
    numbers = samples_of(count, rows, across)
    there = (numbers > 0) | (np.arange(numbers.size).reshape(numbers.shape) == 0)
    np.testing.assert_array_equal(np.sort(numbers[there]), np.arange(count))
    assert len(numbers) <= 1.25 * -(-count // 32)
    assert rows == 1 or (rows, across) == (4, width)


@pytest.mark.parametrize("width", [64, 65])
def test_pieces_of_an_image_are_8_by_4_pixels(width: int) -> None:
    rows, across = shape_of(48 * width, width)
    numbers = samples_of(48 * width, rows, across)
    at = 1 + width // 8 + (width % 8 > 0)  # the second piece of the second row of pieces
    expected = (4 + np.arange(4))[:, None] * width + 8 + np.arange(8)
    np.testing.assert_array_equal(numbers[at].reshape(4, 8), expected)


# --- rays in tiles ---

_LIGHTS: tuple[Light, ...] = (
    PointLight("inside", (0.1, 0.2, 2.6)),
    PointLight("outside", (3.0, -4.0, -1.0)),
    DirectionalLight("sun", (-0.3, 0.4, 0.8)),
    SpotLight("spot", (0.3, -0.5, 0.5), (0.0, 0.1, 1.0), 0.4),
    PointLight("at a sample", (0.0, 0.0, 2.0)),
)


def _steps(width: int, height: int) -> np.ndarray:
    """A floor with edges: squares of 11 pixels, some of them at another depth."""
    rows, columns = np.mgrid[:height, :width]
    return (2.0 + ((rows // 11 + columns // 11) % 3 == 0) + 0.001 * columns).astype(np.float32)


def _fog(width: int, height: int) -> np.ndarray:
    return np.random.default_rng(480).uniform(1.0, 6.0, (height, width)).astype(np.float32)


def _gaps(width: int, height: int) -> np.ndarray:
    depth = _steps(width, height)
    depth[np.random.default_rng(481).random(depth.shape) < 0.4] = np.nan
    return depth


def _pair(lights: int, rays: int) -> tuple[ShadowTracer, ShadowTracer]:
    bounds = Bounds(max_triangles=400, max_rays=lights * rays, max_lights=lights)
    grid = ShadowTracer("light_grid", "packed", "cpu", bounds, threads=1)
    other = ShadowTracer("brute_force", "filtered", "cpu", Bounds(400, rays, lights), threads=1)
    vertices, triangles = geometry.soup(np.random.default_rng(482), 120, 0.3, 1.5)
    for tracer in (grid, other):
        tracer.scene.put("mesh", vertices + [0.0, 0.0, 1.5], triangles)
    return grid, other


def _check_tiles(grid: ShadowTracer, other: ShadowTracer, lamp: Light, light: int = 0) -> int:
    """The rays of a light that has been traced alone are those of brute force, and each is in one tile; returns how
    many pieces there are more than the image has."""
    pipeline, samples = probe.pipeline(grid), probe.context(grid).samples
    packed = packed_grid.read(probe_accelerators.tiles(pipeline))
    rays = probe.context(other).samples.rays.numpy()[: samples.count]
    lit = probe.context(other).samples.states_of(light).numpy() <= 1
    wild = probe_accelerators.wild_rays(pipeline)
    expected = np.setdiff1d(np.flatnonzero(lit & np.isfinite(rays[:, 0])), wild)
    # Tracing takes rays out of the tiles: these are as they were before it.
    live = probe_accelerators.kept_live(pipeline, len(packed.live))
    tile, lane = np.nonzero(live)
    np.testing.assert_array_equal(np.sort(packed.order[tile, lane]), expected)
    number, frame = packed.order[tile, lane], make_light_frame(lamp, probe.anchor(grid))
    step = samples.positions.numpy()[number, 3] * frame.inverse_scale
    found, those = packed.rays[tile, lane, :4].astype(np.float64), rays[number].astype(np.float64)
    # Both are rounded, and of what lights share exactness.md says what else it is off by.
    off = np.abs(found - those)
    assert (off <= 2.0**-23 * np.abs(those) + (2.0**-31 + 7 * 2.0**-24 * step)[:, None]).all()
    shared = np.zeros(len(live), bool)
    shared[tile[(off > 0).any(axis=1)]] = True
    assert shared.any() != isinstance(lamp, SpotLight)
    # The filter's bounds are those of the largest ray; what has been split has those of the whole.
    most, more = packed_grid.most_of(packed.rays, live), 2.0**-8 + 4.0 * float(step.max(initial=0.0))
    assert (packed.magnitudes >= (1.0 - 2.0**-20) * (most + more * shared[:, None])).all()
    assert (packed.magnitudes <= (1.0 + 2.0**-20) * (most + more * shared.any())).mean() > 0.4
    pieces = probe_accelerators.pieces(pipeline)
    return int(pieces.count.numpy()[0]) - int(pieces.of_light)


@pytest.mark.parametrize("image", [_steps, _fog, _gaps])
@pytest.mark.parametrize("number", range(len(_LIGHTS)))
@pytest.mark.parametrize("width, height", [(96, 64), (70, 33)])
def test_rays_are_those_of_brute_force(image: Any, number: int, width: int, height: int) -> None:
    camera = Camera(width, height, 0.6 * width, 0.6 * width, 0.5 * width - 0.5, 0.5 * height - 0.5)
    grid, other = _pair(1, width * height)
    frames = [tracer.trace(image(width, height), camera, [_LIGHTS[number]], 0.01) for tracer in (grid, other)]
    name = _LIGHTS[number].name
    np.testing.assert_array_equal(frames[0].state(name), frames[1].state(name))
    assert frames[0].counters["rays"] == frames[1].counters["rays"]
    _check_tiles(grid, other, _LIGHTS[number])


def test_edges_are_split_and_fog_is_taken_apart() -> None:
    camera = Camera(96, 64, 60.0, 60.0, 47.5, 31.5)
    grid, other = _pair(1, 96 * 64)
    more, taken = {}, {}
    for image in (_steps, _fog):
        for tracer in (grid, other):
            tracer.trace(image(96, 64), camera, [_LIGHTS[1]], 0.01)
        more[image] = _check_tiles(grid, other, _LIGHTS[1])
        taken[image] = probe_accelerators.pieces_made(probe.pipeline(grid))
    assert more[_steps] >= 20  # halves
    assert taken[_fog] >= 100


def test_no_room_for_halves() -> None:
    """What cannot be split for want of room stays, or is taken apart."""
    camera = Camera(96, 64, 60.0, 60.0, 47.5, 31.5)
    grid, other = _pair(1, 96 * 64)
    pieces = probe_accelerators.pieces(probe.pipeline(grid))
    pieces.room = 96 * 64 // 32 + 3
    for tracer in (grid, other):
        tracer.trace(_steps(96, 64), camera, [_LIGHTS[1]], 0.01)
    assert 3 <= _check_tiles(grid, other, _LIGHTS[1]) <= 3 + 6


@pytest.mark.parametrize("lights", [1, 5])
def test_sequences_of_shapes(lights: int) -> None:
    """Images of unlike shapes, and points in between, on one tracer; lights of a pass do not mix."""
    rng = np.random.default_rng(483)
    grid, other = _pair(5, 96 * 64)
    for width, height in [(96, 64), (33, 17), (64, 96), (1, 700), (700, 1), (96, 64), (5, 5), (1, 1)]:
        camera = Camera(width, height, 40.0, 40.0, 0.5 * width - 0.5, 0.5 * height - 0.5)
        depth = rng.uniform(1.0, 4.0, (height, width)).astype(np.float32)
        some = _LIGHTS[:lights]
        frames = [tracer.trace(depth, camera, some, 0.01) for tracer in (grid, other)]
        for light in some:
            np.testing.assert_array_equal(frames[0].state(light.name), frames[1].state(light.name))
        points = rng.uniform(-1.0, 3.0, (width * height // 2 + 1, 3))
        for light in some:
            one, two = (tracer.occluded(points, light, 0.001) for tracer in (grid, other))
            np.testing.assert_array_equal(one, two)


# --- points ---


def _grid_of_points(width: int, height: int) -> np.ndarray:
    """(width * height, 3) points of a slope with steps, row by row."""
    camera = Camera(width, height, 60.0, 60.0, 0.5 * width - 0.5, 0.5 * height - 0.5)
    return camera.unproject(_steps(width, height).astype(np.float64)).reshape(-1, 3)


def _points(kind: str) -> tuple[np.ndarray, set[int]]:
    """Points, and what they may be taken for."""
    rng = np.random.default_rng(484)
    points = _grid_of_points(60, 80)
    if kind == "some left out":
        return points[np.delete(np.arange(4800), [70, 71, 400, 1800, 1801, 1802, 4000])], {59, 60, 61}
    if kind == "shuffled":
        return rng.permutation(points), {-1}
    if kind == "one place":
        return np.repeat(points[:1], 4800, axis=0), set(range(-1, 1201))
    if kind == "a line":
        return np.array([-1.0, 0.0, 2.5]) + np.arange(4800)[:, None] * [4e-4, 1e-4, 2e-4], {0}
    if kind == "few":
        return points[:96], {0}
    return points, {60}


@pytest.mark.parametrize("kind", ["rows", "some left out", "shuffled", "one place", "a line", "few"])
def test_points_in_rows(kind: str) -> None:
    """What points are taken for is a question of time; after any other kind on the same tracer."""
    grid, other = _pair(1, 4800)
    for points, expected in (_points(kind), _points("rows"), _points("shuffled"), _points(kind)):
        for light in (_LIGHTS[0], _LIGHTS[1], _LIGHTS[2]):
            one, two = (tracer.occluded(points, light, 0.001) for tracer in (grid, other))
            np.testing.assert_array_equal(one, two)
        assert probe_accelerators.row_of_points(probe.pipeline(grid)) in expected


def test_room_for_all_pieces() -> None:
    """There may be as many as a quarter more than full ones, of each light, and one for each group."""
    for count, width in _SHAPES:
        for lights in (1, 3):
            pieces = len(samples_of(count, *shape_of(count, width)))
            assert lights * pieces + 6 * lights <= most_pieces(lights * count, lights)
