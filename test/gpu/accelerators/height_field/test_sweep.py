# SPDX-License-Identifier: Apache-2.0
"""The sun's sweep over terrain: every answer is brute_force's, whatever the sun, the samples and the holes; and it is
the sweep that gives most of them."""

from __future__ import annotations

from typing import Any

import data
import numpy as np
import probe
import pytest
import surfaces
from surfaces import agree, sun

from shadow_tracer import DirectionalLight, HeightField
from shadow_tracer.gpu.accelerators.height_field import charts

pytestmark = probe.in_both_forms

_AZIMUTHS = (0.0, 45.0, 90.0, 117.0, 180.0, 200.0, 225.0, 270.0, 301.0, 315.0)


def _samples(rng: np.random.Generator, field: HeightField) -> np.ndarray:
    """Positions to the last bit, above and below them, next to the surface, anywhere, and beside it."""
    positions = field.positions()[field.valid]
    rows, columns = field.shape
    low, high = positions.min(axis=0), positions.max(axis=0)
    anywhere = rng.uniform(low - 1.0, high + 1.0, (400, 3))
    moved = [positions + (0, 0, up) for up in (0.1, 2.0, -0.1, 1e-4, -1e-4, 1e-8, -1e-8)]
    halfway = 0.5 * (positions[1:] + positions[:-1])
    near = positions + 1e-3 * rng.uniform(-1, 1, positions.shape)
    return np.concatenate([positions, *moved, halfway, near, anywhere])


def _ground(scene: Any, field: HeightField) -> None:
    scene.put_surface("ground", field)


def _is_swept(tracer: Any) -> bool:
    return probe.charts(tracer)[1] >= 0


@pytest.mark.parametrize("elevation", [-5.0, 0.0, 0.1, 2.0, 10.0, 45.0, 80.0])
@pytest.mark.parametrize("holes", [False, True])
def test_suns(any_device: str, elevation: float, holes: bool) -> None:
    rng = np.random.default_rng(1)
    z = surfaces.terrain(rng, 24, 31)
    if holes:
        z[8:11, 12:20], z[20, 4], z[0, 7], z[23, 30] = np.nan, np.nan, np.nan, np.nan
    field = HeightField(z, (1.0, 1.25))
    points = _samples(rng, field)
    suns = [sun(elevation, azimuth) for azimuth in _AZIMUTHS]
    states, _, tracer = agree(any_device, lambda scene: _ground(scene, field), points, suns)
    assert _is_swept(tracer) and (elevation > 40 or 0.2 < (states == 1).mean() < 0.95)


@pytest.mark.parametrize("bias", [1e-6, 0.01, 0.7, 5.0])
def test_biases(any_device: str, bias: float) -> None:
    rng = np.random.default_rng(2)
    field = HeightField(surfaces.terrain(rng, 24, 24), 1.0, origin=(5e5, 5e6, 200.0))
    suns = [sun(elevation, azimuth) for elevation in (0.5, 8.0, 40.0) for azimuth in (30.0, 160.0, 270.0)]
    states, _, tracer = agree(any_device, lambda scene: _ground(scene, field), _samples(rng, field), suns, bias)
    assert _is_swept(tracer) and (states == 1).any()


@pytest.mark.parametrize("axes", [((0, -1), (1, 0)), ((-1, 0), (0, -1)), ((0, 1), (1, 0)), ((0.6, 0.8), (0.8, -0.6))])
def test_every_way_that_rows_and_columns_go(any_device: str, axes: Any) -> None:
    rng = np.random.default_rng(3)
    z = surfaces.terrain(rng, 20, 26)
    z[5, 5] = np.nan
    field = HeightField(z, (0.9, 1.1), axes=axes)
    suns = [sun(4.0, azimuth) for azimuth in np.arange(0.0, 360.0, 24.0)]
    _, _, tracer = agree(any_device, lambda scene: _ground(scene, field), _samples(rng, field), suns)
    assert _is_swept(tracer)


@pytest.mark.parametrize("bias", [0.0, 1e-4])
def test_stairs_that_rays_touch(any_device: str, bias: float) -> None:
    """Whole heights and suns of whole slopes: rays pass through positions, and along rows, columns, diagonals and
    triangles, everywhere; where heights are rounded, nearly so: with a bias that is a matter of roundings."""
    rng = np.random.default_rng(4)
    field = HeightField(rng.integers(0, 5, (20, 20)).astype(float), 1.0, origin=(1.0, 8.0, 0.001 if bias else 0.0))
    ways = [(x, y, z) for x, y in ((1, 0), (0, 1), (1, 1), (-1, 1), (2, 1), (-1, -2)) for z in (0, 1, -1)]
    points = np.concatenate([field.positions().reshape(-1, 3) + (0, 0, k) for k in (0, 1, 2)])
    lights = [DirectionalLight(f"sun {k}", way) for k, way in enumerate(ways)]
    for some in (lights[:9], lights[9:]):
        states, _, tracer = agree(any_device, lambda scene: _ground(scene, field), points, some, bias)
        assert _is_swept(tracer) and 0.2 < (states == 1).mean() < 0.9


def test_a_bias_where_a_triangle_is_nearly_in_the_way(any_device: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """A ray from below comes out of the surface along a triangle, but for roundings: with a bias, the exact decision
    compares distances that float64 does not know."""
    monkeypatch.setattr(charts, "_FEWEST_QUADS", 1)
    quarters = [
        (-2, -1, 0, 0, 2, 1, 2, 4),
        (-3, -1, 1, 2, 1, 2, 2, 3),
        (-2, -1, 0, 2, 2, 1, 2, 3),
        (-1, -1, 1, 2, 2, 1, 1, 2),
        (-1, 0, 1, 4, 3, 2, 0, -1),
        (1, 1, 1, 3, 2, 2, 1, 1),
        (0, 1, 2, 1, 0, 0, 1, 1),
        (1, 2, 1, 2, 1, 2, 2, 4),
    ]
    field = HeightField(np.array(quarters) / 4.0, 1.25, origin=(12.25, -17.0, 0.001))
    points = field.positions().reshape(-1, 3)
    light = DirectionalLight("sun", (2, -3, -1))
    for bias in (0.0, 1e-4):
        states, _, tracer = agree(any_device, lambda scene: _ground(scene, field), points, [light], bias)
        assert _is_swept(tracer) and (states == 1).any()


def test_a_hole_lets_the_sun_through(any_device: str) -> None:
    """A wall with a gap, and a wall whose foot is missing: rays below the surface's heights that meet no triangle."""
    z = np.zeros((30, 30))
    z[:, 15] = 10.0
    z[12:18, 14:17] = np.nan
    z[22, 14] = np.nan
    field = HeightField(z, 1.0)
    points = field.positions()[field.valid] + (0.0, 0.0, 0.5)
    suns = [sun(elevation, azimuth) for elevation in (0.3, 5.0) for azimuth in (90.0, 270.0, 80.0, 285.0, 45.0)]
    states, _, tracer = agree(any_device, lambda scene: _ground(scene, field), points, suns)
    seen = states[0].reshape(-1)[(points[:, 0] == 3.0) & (points[:, 1] > -21.0) & (points[:, 1] < -9.0)]
    assert _is_swept(tracer) and (seen == 0).any() and (seen == 1).any()


def _facing(field: HeightField, towards: np.ndarray, away: float) -> np.ndarray:
    """Samples a little above and below the rays to the sun that touch the surface at positions and between them, and so
    far from these."""
    positions = field.positions()
    places = [positions, 0.5 * (positions[1:] + positions[:-1]), 0.5 * (positions[:, 1:] + positions[:, :-1])]
    places += [0.5 * (positions[1:, 1:] + positions[:-1, :-1]), 0.5 * (positions[1:, :-1] + positions[:-1, 1:])]
    tips = np.concatenate([each.reshape(-1, 3) for each in places])
    return np.concatenate([tips - away * towards + (0.0, 0.0, up) for up in (0.01, -0.01)])


@pytest.mark.parametrize("rising", [1, -1])
def test_ridges_between_two_lines(any_device: str, rising: int) -> None:
    """Walls along diagonals, whose tops bands cross between lines, higher than on them."""
    down, across = np.mgrid[:20, :26]
    field = HeightField(np.where((across + rising * down) % 9 == 4, 6.0, 0.0), 1.0)
    for azimuth in np.arange(7.0, 360.0, 15.0):
        light = sun(4.0, azimuth)
        points = _facing(field, -np.asarray(light.direction), 5.3)
        states, _, tracer = agree(any_device, lambda scene: _ground(scene, field), points, [light])
        assert _is_swept(tracer) and 0.2 < (states == 1).mean() < 0.98


@pytest.mark.parametrize("axis", [0, 1])
def test_spikes_within_stretches_and_at_their_ends(any_device: str, axis: int) -> None:
    """A plain with a few single positions that stick out, holes, and rays that go far over it."""
    rng = np.random.default_rng(11)
    shape = (90, 12) if axis == 0 else (12, 90)
    z = rng.integers(0, 9, shape) / 1000.0
    for k, line in enumerate((0, 15, 16, 17, 31, 33, 40, 48, 63, 64, 79, 80, 89)):
        place = (line, k % 12) if axis == 0 else (k % 12, line)
        z[place] = 1.0 + rng.integers(0, 200) / 100.0
    z[60:62, 5:7] = np.nan if axis == 0 else z[60:62, 5:7]
    field = HeightField(z, 1.0)
    points = np.concatenate([field.positions()[field.valid] + (0.0, 0.0, up) for up in (0.05, 0.5, 1.5)])
    first = 180.0 if axis == 0 else 90.0
    suns = [sun(elevation, first + turn) for elevation in (0.0, 0.7, 1.9) for turn in (0.0, 2.1, 178.0, 181.5)]
    states, counters, tracer = agree(any_device, lambda scene: _ground(scene, field), points, suns)
    assert _is_swept(tracer) and 0.02 < (states == 1).mean() < 0.9
    assert counters["nodes_visited"] < 8 * states.size  # ten if rays go from line to line


@pytest.mark.parametrize("hole", [0, 8])
def test_rays_beside_a_border_by_less_than_is_rounded(any_device: str, hole: int) -> None:
    """They go to a wall that ends a billionth of a cell beside them: they are taken to the border, and pass it."""
    z = np.zeros((24, 24))
    z[:, 15:], z[:hole] = 10.0, np.nan
    field = HeightField(z, 1.0)
    along, up = np.meshgrid(np.arange(6.25, 15.0, 0.5), np.arange(0.25, 9.0, 0.5))
    points = np.stack([along, np.full(along.shape, 1e-9 - hole), up], axis=-1).reshape(-1, 3)
    states, _, tracer = agree(any_device, lambda scene: _ground(scene, field), points, [sun(0.0, 90.0)])
    assert _is_swept(tracer) and (states == 0).any()


def test_it_decides_nearly_all(any_device: str) -> None:
    """Of a hundred rays a few are left to the exact walk; alone they are all; the answers are the same."""
    rng = np.random.default_rng(5)
    field = HeightField(surfaces.terrain(rng, 64, 64), 1.0)
    points = field.positions().reshape(-1, 3) + (0.0, 0.0, 0.2)
    tracer = surfaces.tracer(any_device, "height_field")
    _ground(tracer.scene, field)
    for elevation in (2.0, 10.0, 45.0):
        light = sun(elevation, 123.0)
        together = probe.trace_points(tracer, points, [light])
        assert _is_swept(tracer) and together.counters["leaf_tests"] < 0.15 * len(points)
        some = slice(None, None, 16)
        alone = probe.trace_points(tracer, points[some], [light])
        assert not _is_swept(tracer) and alone.counters["leaf_tests"] > 0.3 * len(points[some])
        assert np.array_equal(together.states[0].reshape(-1)[some], alone.states[0].reshape(-1))


def test_the_same_sun_over_a_surface_that_changes(any_device: str) -> None:
    """A sweep is kept for as long as the surface, its place in memory and the sun are the same."""
    rng = np.random.default_rng(9)
    ours = surfaces.tracer(any_device, "height_field")
    pose = np.eye(4)
    pose[0, 3] = 3.5
    points = rng.uniform((-2, -22, -3), (25, 2, 4), (2000, 3))

    def field() -> HeightField:
        return HeightField(surfaces.terrain(rng, 20, 20), 1.0)

    fields = [field() for _ in range(3)]
    steps: list[Any] = [
        lambda scene: scene.put_surface("ground", fields[0]),
        lambda scene: None,
        lambda scene: scene.deform_surface("ground", fields[1]),
        lambda scene: scene.move("ground", pose),
        lambda scene: scene.put_surface("hill", HeightField(fields[2].z[:12, :12], 1.0, (30.0, 0.0, 0.0))),
        lambda scene: scene.remove("ground"),
        lambda scene: scene.put_surface("ground", fields[1]),
        lambda scene: scene.put_surface("ground", fields[2]),
    ]
    for number in range(len(steps)):

        def setup(scene: Any, number: int = number) -> None:
            for step in steps[number : number + 1] if scene is ours.scene else steps[: number + 1]:
                step(scene)

        agree(any_device, setup, points, [sun(7.0, 130.0)], ours=ours)


@pytest.mark.parametrize("count", [1100, 1500, 2049])
def test_invalid_points_and_odd_numbers_of_them(any_device: str, count: int) -> None:
    """Below the ground, where all that ask are hidden; blocks of rays are full, or not."""
    rng = np.random.default_rng(10)
    z = surfaces.terrain(rng, 32, 32)
    points = rng.uniform((1, -30, z.min() - 1), (30, -1, z.max() + 1), (count, 3))
    points[rng.random(count) < 0.2] = np.nan
    found = []
    for pipeline in ("height_field", "brute_force"):
        tracer = surfaces.tracer(any_device, pipeline)
        # The origin, which invalid points are put at, is below the ground.
        tracer.scene.put_surface("ground", HeightField(z - z.min() + 5.0, 1.0, origin=(-10.0, 10.0, 0.0)))
        found.append(tracer.states_at(points, [sun(20.0, 70.0), sun(50.0, 300.0)]))
    assert np.array_equal(found[0], found[1]) and set(np.unique(found[0])) == {0, 1, 3}


def test_when_nothing_is_swept(any_device: str) -> None:
    rng = np.random.default_rng(6)
    field = HeightField(surfaces.terrain(rng, 20, 20), 1.0)
    points = field.positions().reshape(-1, 3)
    for light, cull in ((sun(90.0, 0.0), False), (sun(10.0, 50.0), True)):
        _, _, tracer = agree(any_device, lambda scene: _ground(scene, field), points, [light], 0.0, cull)
        assert not _is_swept(tracer)


def test_positions_out_of_place_are_not_swept(any_device: str) -> None:
    rng = np.random.default_rng(7)
    positions = HeightField(surfaces.terrain(rng, 24, 24), 1.0).positions()
    positions[..., :2] += rng.uniform(-0.02, 0.02, (24, 24, 2))
    points = np.concatenate([positions.reshape(-1, 3) + (0, 0, up) for up in (0.0, 0.01, 0.3)])
    suns = [sun(elevation, azimuth) for elevation in (1.0, 12.0) for azimuth in (0.0, 100.0, 250.0)]
    _, counters, _ = agree(any_device, lambda scene: scene.put_surface("ground", positions), points, suns)
    assert counters["leaf_tests"] > len(points)


def test_meshes_and_a_second_terrain_in_the_sun(any_device: str) -> None:
    rng = np.random.default_rng(8)
    ground = HeightField(surfaces.terrain(rng, 30, 30), 1.0)
    hill = HeightField(3.0 + surfaces.terrain(rng, 12, 12), 1.0, origin=(12.0, -10.0, 0.0))
    rock = np.array([(5.0, -5.0, 4.0), (9.0, -5.0, 4.0), (7.0, -9.0, 5.0)])

    def setup(scene: Any) -> None:
        scene.put_surface("hill", hill)
        scene.put_surface("ground", ground)
        scene.put("rock", rock, [(0, 1, 2)])

    points = np.concatenate([ground.positions().reshape(-1, 3) + (0, 0, up) for up in (0.0, 0.2)])
    suns = [sun(elevation, azimuth) for elevation in (5.0, 30.0, 70.0) for azimuth in (10.0, 130.0, 220.0)]
    _, _, tracer = agree(any_device, setup, points, suns)
    assert _is_swept(tracer) and sorted(probe.charts(tracer)[0]) == ["ground", "hill"]


def test_suns_that_ignore_terrain_or_meshes(any_device: str) -> None:
    """What one light ignores casts for the next one: terrain that is swept, terrain that is not, and a mesh."""
    rng = np.random.default_rng(9)
    ground = HeightField(surfaces.terrain(rng, 30, 30), 1.0)
    hill = HeightField(3.0 + surfaces.terrain(rng, 12, 12), 1.0, origin=(12.0, -10.0, 0.0))
    rock = np.array([(5.0, -5.0, 4.0), (9.0, -5.0, 4.0), (7.0, -9.0, 5.0)])

    def setup(scene: Any) -> None:
        scene.put_surface("ground", ground)
        scene.put_surface("hill", hill)
        scene.put("rock", rock, [(0, 1, 2)])

    points = np.concatenate([ground.positions().reshape(-1, 3) + (0, 0, up) for up in (0.0, 0.2)])
    ignored: list[list[str]] = [[], ["ground"], ["hill"], ["rock"], ["ground", "hill", "rock"], ["nobody"]]
    suns = [DirectionalLight(str(k), sun(15.0, 130.0).direction, ignore=names) for k, names in enumerate(ignored)]
    states, _, tracer = agree(any_device, setup, points, suns)
    hidden = (states == 1).reshape(len(suns), -1).sum(axis=1)
    assert hidden[0] == hidden[5] > hidden[1:4].max() and hidden[1:4].min() > hidden[4] == 0
    states, _, _ = agree(any_device, setup, points, suns[::-1], ours=tracer)
    assert ((states == 1).reshape(len(suns), -1).sum(axis=1) == hidden[::-1]).all()


@pytest.mark.parametrize("name", ["dem_squared", "dem_moon"])
def test_recorded_terrain(any_device: str, name: str) -> None:
    images = pytest.importorskip("PIL.Image", reason="real data: Pillow is needed to read the elevations")
    with images.open(data.file(f"dem/{name}.tif")) as image:
        z = np.asarray(image, dtype=np.float64)[:49, :49]
    field = HeightField(z, (30.8, 24.4) if name == "dem_squared" else 2.42661, origin=(555_000.0, 4_200_000.0, 0.0))
    positions = field.positions().reshape(-1, 3)
    points = np.concatenate([positions, positions + (0, 0, 2.0)])
    suns = [sun(elevation, azimuth) for elevation in (0.1, 2.0, 10.0) for azimuth in (95.0, 200.0)]
    states, _, tracer = agree(any_device, lambda scene: _ground(scene, field), points, suns)
    assert _is_swept(tracer) and (states == 1).any()
