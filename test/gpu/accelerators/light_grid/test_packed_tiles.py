# SPDX-License-Identifier: Apache-2.0
"""Rays packed into tiles, by both forms: every ray has one lane, boxes of all levels hold their rays, sizes are as
promised."""

from __future__ import annotations

from functools import cache

import geometry
import numpy as np
import probe
import pytest
from packed_grid import BLOCK, LEVELS, NEAR, OUTSIDE, TILE, Packed, Packing, most_of

from shadow_tracer import DirectionalLight
from shadow_tracer.gpu.accelerators.admission import ABSENT, IN_TREE, WILD
from shadow_tracer.scene.lights import Light

_MOST = 20_000
_SUN = DirectionalLight("sun", (0.0, 0.0, -1.0))


@cache
def _packing(device: str, form: str) -> Packing:
    """To be called, and used, in that form."""
    return Packing(device, _MOST + 1, 4)


def _face_of(ray: np.ndarray) -> np.ndarray:
    """(N,) cube faces; of equal coordinates the first counts."""
    axis = np.argmax(np.abs(ray[:, :3]), axis=1)
    return 2 * axis + (ray[np.arange(len(ray)), axis] < 0.0)


def _cell(u: np.ndarray, fit: np.ndarray) -> np.ndarray:
    x = (u.astype(np.float32) - fit[0]) * fit[2] * np.float32(0.0625)
    cell: np.ndarray = np.clip(x, 0.0, 255.0).astype(int)
    return cell


def _fit(rays: np.ndarray) -> bool:
    """Whether (N, 4) rays fit into the frustum."""
    return bool((rays[:, 2] > 0.0).all() and (np.abs(rays[:, :2]) <= 2.0 * rays[:, 2:3]).all())


def _on_face(rays: np.ndarray, face: np.ndarray, inverse: bool) -> np.ndarray:
    """(N, 3) exact u, v, t in float64."""
    rays = rays.astype(np.float64)
    at, axis = np.arange(len(rays)), face // 2
    size = np.where(face % 2, -1.0, 1.0) * rays[at, axis]
    depth = 1.0 if inverse else rays[:, 3]
    return np.column_stack([rays[at, (axis + 1) % 3] / size, rays[at, (axis + 2) % 3] / size, depth / size])


def _check(packed: Packed, rays: np.ndarray, inside: np.ndarray, inverse: tuple[bool, ...], fits: list[bool]) -> None:
    """(lights, N, 4) rays, of which those `inside`, (lights, N), are to be in tiles; and whether the rays of each light
    fit into one frustum."""
    lights, samples = inside.shape
    np.testing.assert_array_equal(packed.aligned != 0, fits)
    tile, lane = np.nonzero(packed.live)
    ray = packed.order[tile, lane]
    assert packed.counts[0] == len(ray) == inside.sum()
    np.testing.assert_array_equal(np.sort(ray), np.flatnonzero(inside))
    flat = rays.reshape(-1, 4)
    np.testing.assert_array_equal(packed.rays[tile, lane, :4], flat[ray])
    if packed.pieces:
        assert (packed.magnitudes >= most_of(packed.rays, packed.live)).all()
    else:
        size = np.abs(flat[ray][:, (0, 1, 3)].astype(np.float64)).sum(axis=1)
        np.testing.assert_allclose(packed.rays[tile, lane, 4], size + 2.0**-20, rtol=4e-7)
    # which group, and how many rays in each
    place = ray // samples
    face = np.where(np.array(fits)[place], 4, _face_of(flat[ray]))
    where = packed.boxes["tile"]
    group_of = np.full(len(packed.live), -1)
    group_of[where.number] = where.group
    np.testing.assert_array_equal(group_of[tile], 6 * place + face)
    used = packed.live.sum(axis=1)
    if packed.pieces:
        some = group_of[used > 0]
        np.testing.assert_array_equal(packed.groups[:, 1], TILE * np.bincount(some, minlength=6 * lights))
        _check_sizes(packed, TILE * (used > 0))
    else:
        np.testing.assert_array_equal(packed.groups[:, 1], np.bincount(6 * place + face, minlength=6 * lights))
        assert (packed.live == (np.arange(TILE) < used[:, None])).all()
        _check_sizes(packed, used)
    _check_boxes(packed, tile, _on_face(flat[ray], face, False), inverse, flat[ray], face, place)


def _check_sizes(packed: Packed, used: np.ndarray) -> None:
    """Full tiles but for the last of a group, if they are not pieces; columns of whole blocks, sixteen at most; nothing
    overlaps."""
    block = column = 0
    for first, rays, length, first_column, columns, first_block in packed.groups.tolist():
        assert first_column % 16 == 0 and first_column >= column and first_block == block and first >= 0
        assert length % BLOCK == 0 and 1 <= length // BLOCK <= 16 and columns == -(-rays // length)
        tiles = used[16 * block : 16 * (block + -(-rays // BLOCK))]
        expected = np.clip(rays - TILE * np.arange(len(tiles)), 0, TILE)
        np.testing.assert_array_equal(tiles, expected)
        block, column = block + -(-rays // BLOCK), first_column + columns
    assert packed.counts[2] == block
    assert packed.counts[1] >= column


def _check_boxes(
    packed: Packed,
    tile: np.ndarray,
    on: np.ndarray,
    inverse: tuple[bool, ...],
    rays: np.ndarray,
    face: np.ndarray,
    place: np.ndarray,
) -> None:
    """Boxes of all levels hold their rays and little more; what holds nothing says so."""
    one_by_depth = np.array(inverse)[place]
    at = np.where(one_by_depth[:, None], _on_face(rays, face, True), on)
    tiles = packed.boxes["tile"]
    position = np.full(len(packed.live), -1)
    position[tiles.number] = np.arange(len(tiles.number))
    places = packed.places()
    slack = 4e-6 * (1.0 + np.abs(at).max(initial=0.0) * np.array([0.0, 0.0, 1.0]))
    for level in LEVELS:
        boxes = packed.boxes[level]
        number = places[level][position[tile]]
        index = np.searchsorted(boxes.number, number)
        np.testing.assert_array_equal(boxes.number[index], number)
        assert ((boxes.low[index] < at) & (at < boxes.high[index])).all()
        least, most = np.full(boxes.low.shape, np.inf), np.full(boxes.low.shape, -np.inf)
        np.minimum.at(least, index, at)
        np.maximum.at(most, index, at)
        assert (boxes.low > least - slack).all() and (boxes.high < most + slack).all()
    for level in LEVELS:
        assert (packed.boxes[level].low <= packed.boxes[level].high).all()
        assert (packed.empty[level] <= -1e29).all()
    columns = packed.boxes["column"]
    for group, k, low_u, high_u in zip(columns.group, columns.column, columns.low, columns.high, strict=True):
        cells = _cell(np.array([low_u[0], high_u[0]]), packed.fit[group])
        assert (packed.lookup[group, : cells[1] + 1, 0] <= k).all() and (packed.lookup[group, cells[0] :, 1] >= k).all()


def _rays(rng: np.random.Generator, kind: str, count: int) -> np.ndarray:
    """(count, 4) rays: directions, and depths along the light's axis."""
    way = geometry.directions(rng, count).reshape(count, 3)
    if kind == "frustum":
        way = np.column_stack([rng.uniform(-2.0, 2.0, (count, 2)), np.ones(count)])
    elif kind == "wide":
        way = np.column_stack([rng.uniform(-2.0, 2.0, count), rng.uniform(-0.02, 0.02, count), np.ones(count)])
    elif kind == "tall":
        way = np.column_stack([rng.uniform(-0.02, 0.02, count), rng.uniform(-2.0, 2.0, count), np.ones(count)])
    elif kind == "one direction":
        way = np.tile([0.3, -0.7, 0.4], (count, 1))
    elif kind == "one u":
        way = np.column_stack([np.full(count, 0.25), rng.uniform(-1.0, 1.0, count), np.ones(count)])
    elif kind == "clusters":
        middle = geometry.directions(rng, 7)[rng.choice(7, count, p=[0.6, 0.3, 0.05, 0.03, 0.01, 0.005, 0.005])]
        way = middle + rng.normal(size=(count, 3)) * rng.choice([0.0, 1e-6, 1e-3], (count, 1))
    elif kind == "diagonals":
        way = rng.integers(-1, 2, (count, 3)).astype(float)
        way[(way == 0.0).all(axis=1)] = 1.0
    length = rng.uniform(0.05, 20.0, (count, 1))
    return np.column_stack([way * length, rng.normal(size=count) * 3.0]).astype(np.float32)


_KINDS = ("sphere", "frustum", "wide", "tall", "one direction", "one u", "clusters", "diagonals")
_SIZES = (0, 1, 31, 32, 33, 511, 512, 513, 8191, 8192, 8193, _MOST)


@probe.in_both_forms
@pytest.mark.parametrize("light", [NEAR, OUTSIDE, _SUN], ids=lambda light: light.name)
@pytest.mark.parametrize("kind", _KINDS)
@pytest.mark.slow
def test_one_light(any_device: str, kernel_form: str, kind: str, light: Light) -> None:
    most_blocks = 0
    for seed, count in enumerate(_SIZES):
        # and one that does not take part, as a pass has at least one
        rays = _rays(np.random.default_rng([460, seed]), kind, count + 1)[None]
        inside = np.arange(count + 1)[None] > 0
        packed = _packing(any_device, kernel_form).pack(rays, inside.astype(np.uint8), lights=(light,))
        _check(packed, rays, inside, (light is NEAR,), [_fit(rays[inside])])
        most_blocks = max(most_blocks, int(packed.groups[:, 2].max()) // BLOCK)
    # 20,000 rays in one frustum: 2 blocks a column if it is square, 4 if it is tall
    expected = {"frustum": 2, "wide": 1, "tall": 4, "clusters": 1}
    if packed.pieces:  # whose columns are four times as wide
        expected = {"frustum": 6, "wide": 2, "tall": 16}
    assert most_blocks == expected.get(kind, most_blocks)


@probe.in_both_forms
def test_columns_are_at_most_256_tiles(any_device: str) -> None:
    """300,000 rays in a tall frustum would like columns of seventeen blocks."""
    count = 300_000
    rays = _rays(np.random.default_rng(461), "tall", count)[None]
    packed = Packing(any_device, count).pack(rays)
    _check(packed, rays, np.ones((1, count), bool), (False,), [True])
    assert packed.groups[4, 2] == 16 * BLOCK


@probe.in_both_forms
@pytest.mark.parametrize("count", [1, 63, 700, 4999])
def test_some_rays_of_several_lights(any_device: str, kernel_form: str, count: int) -> None:
    """Rays that are not in tiles, or in shadow before, hold anything and count for nothing; lights do not mix."""
    rng = np.random.default_rng([462, count])
    lights = (NEAR, OUTSIDE, _SUN, NEAR)
    rays = np.stack([_rays(rng, kind, count) for kind in ("sphere", "frustum", "wide", "clusters")])
    kind = rng.choice([int(ABSENT), int(IN_TREE), int(WILD)], (4, count), p=[0.2, 0.7, 0.1]).astype(np.uint8)
    states = rng.choice([0, 1, 4], (4, count), p=[0.6, 0.3, 0.1]).astype(np.uint8)
    kind[3] = np.where(count == 63, int(ABSENT), kind[3])
    rays[kind == int(ABSENT)] = np.nan
    rays[kind == int(WILD)] = (0.0, 1e30, -np.inf, 0.0)
    inside = (kind == int(IN_TREE)) & (states != 1)
    some = [bool((kind[k] == int(IN_TREE)).any()) for k in range(4)]
    packed = _packing(any_device, kernel_form).pack(rays, kind, states, lights)
    _check(packed, rays, inside, (True, False, False, True), [not some[0], True, True, not some[3]])


@probe.in_both_forms
@pytest.mark.parametrize("lights", [16, 64])
def test_as_many_lights_as_there_may_be(any_device: str, lights: int) -> None:
    rng = np.random.default_rng(463)
    rays = np.stack([_rays(rng, "sphere" if k % 3 else "frustum", 300) for k in range(lights)])
    packed = Packing(any_device, lights * 300, lights).pack(rays, lights=(NEAR,) * lights)
    _check(packed, rays, np.ones((lights, 300), bool), (True,) * lights, [k % 3 == 0 for k in range(lights)])


_EDGE = np.nextafter(np.float32(2.0), np.float32(3.0))
_TINY = np.float32(1e-30)


@probe.in_both_forms
@pytest.mark.parametrize("at", [0, 15, 16, 39])
@pytest.mark.parametrize(
    "ray, fits",
    [
        ((2.0, 2.0, 1.0), True),
        ((-2.0, 0.5, 1.0), True),
        ((0.5, -2.0, 1.0), True),
        ((6.0, -6.0, 3.0), True),
        ((_EDGE, 0.0, 1.0), False),
        ((-_EDGE, 0.0, 1.0), False),
        ((0.0, _EDGE, 1.0), False),
        ((0.0, -_EDGE, 1.0), False),
        ((2.0 * _TINY, 0.0, _TINY), True),
        ((0.0, 0.0, 0.0), False),
        ((0.0, 0.0, -1.0), False),
        ((0.5, 0.25, -0.0), False),
    ],
)
def test_border_of_the_frustum(any_device: str, kernel_form: str, ray: tuple[float, ...], fits: bool, at: int) -> None:
    """One ray decides, whichever lane of its sixteen it is in; unless it does not take part."""
    rays = _rays(np.random.default_rng(464), "frustum", 40)
    rays[at] = (*ray, 0.5)
    kind = np.full((1, 40), int(IN_TREE), np.uint8)
    packed = _packing(any_device, kernel_form).pack(rays[None], kind)
    np.testing.assert_array_equal(packed.aligned, [int(fits)])
    if ray[:2] != (0.0, 0.0):
        _check(packed, rays[None], kind == int(IN_TREE), (False,), [fits])
    kind[0, at] = int(WILD)
    packed = _packing(any_device, kernel_form).pack(rays[None], kind)
    _check(packed, rays[None], kind == int(IN_TREE), (False,), [True])


@pytest.mark.parametrize("kind", _KINDS)
@pytest.mark.parametrize("count", [33, 5000])
def test_both_forms_agree(any_device: str, kind: str, count: int) -> None:
    """In frustum and extents, and in the rays of each group."""
    rays = _rays(np.random.default_rng([465, count]), kind, count)[None]
    packed, groups = [], []
    for form in probe.FORMS:
        with probe.form(form):
            one = _packing(any_device, form).pack(rays)
        packed.append(one)
        tiles = one.boxes["tile"]
        groups.append({})
        for number, group in zip(tiles.number, tiles.group, strict=True):
            of_group = groups[-1].setdefault(int(group), set())
            of_group |= set(one.order[number][one.live[number]].tolist())
    np.testing.assert_array_equal(packed[0].aligned, packed[1].aligned)
    np.testing.assert_array_equal(packed[0].counts[0], packed[1].counts[0])
    np.testing.assert_array_equal(packed[0].fit, packed[1].fit)
    assert groups[0] == groups[1]
