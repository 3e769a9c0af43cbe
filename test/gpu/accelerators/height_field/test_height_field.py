# SPDX-License-Identifier: Apache-2.0
"""Height fields: both kinds of charts against brute_force, sizes, masks, rays in the way of everything, other meshes
beside them, and each step of the proof."""

from __future__ import annotations

from typing import Any

import data
import geometry
import numpy as np
import probe
import pytest
import surfaces
from surfaces import agree, around, lights_around, moved, turned

from shadow_tracer import Camera, DirectionalLight, HeightField, PointLight, Scene, SphereLight, render_depth
from shadow_tracer.gpu.accelerators.height_field import charts

pytestmark = probe.in_both_forms


@pytest.fixture(autouse=True)
def _small_surfaces_have_charts(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(charts, "_FEWEST_QUADS", 1)


@pytest.mark.parametrize("cull", [False, True])
@pytest.mark.parametrize("offset", [(0.0, 0.0, 0.0), (5e5, 4e6, 100.0)])
def test_terrain(any_device: str, offset: tuple[float, float, float], cull: bool) -> None:
    rng = np.random.default_rng(1)
    z = surfaces.terrain(rng, 41, 50)
    z[10:13, 20:30], z[30, 31], z[0, 0] = np.nan, np.nan, np.nan
    field = HeightField(z, (1.0, 1.3), origin=offset)
    points = around(rng, field.positions(), 500)
    states, _, tracer = agree(
        any_device,
        lambda scene: scene.put_surface("ground", field),
        points,
        lights_around(np.array(offset) + (30, -20, 0), 30.0),
        0.01 if cull else 0.0,
        cull,
    )
    assert probe.charts(tracer)[0] == ["ground"] and 0.1 < (states == 1).mean() < 0.9


@pytest.mark.parametrize(
    "pose", [np.eye(4), turned(2.0, (1, 2, -0.5), (5.0, -3.0, 2.0)), turned(1.0, (0, 1, 0), (4e5, 5e6, 0))]
)
def test_depth_images(any_device: str, pose: np.ndarray) -> None:
    """Lights in front, behind, in the plane of the optical centre and in that."""
    rng = np.random.default_rng(2)
    positions = surfaces.depth_surface(rng, 36, 48)
    valid = rng.random((36, 48)) > 0.05
    points = around(rng, np.where(valid[..., None], positions, np.nan), 500)
    points[-100:, 2] = -np.abs(points[-100:, 2])
    places = [(0, 0, 0), (0.1, 0, -2), (1, 0, 0), (1, 0.5, 1), (0.1, 0, 30)]
    ways = [(0, 0, 1), (0, 0, -1), (1, 0, 0), (0, 1, 0), (1, 1, 0), (1, 0.2, 0.4), (-0.2, 0.1, -1)]
    lights: list[Any] = [PointLight(f"lamp {k}", moved(pose, np.array(each))) for k, each in enumerate(places)]
    lights += [DirectionalLight(f"sun {k}", pose[:3, :3] @ np.array(each)) for k, each in enumerate(ways)]
    states, _, tracer = agree(
        any_device,
        lambda scene: scene.put_surface("image", positions, valid, pose),
        moved(pose, points),
        lights,
    )
    assert probe.charts(tracer)[0] == ["image"] and 0.1 < (states == 1).mean() < 0.9


@pytest.mark.parametrize(
    "shape", [(1, 2), (2, 1), (2, 2), (2, 3), (3, 2), (5, 5), (6, 5), (17, 18), (513, 2), (2, 513)]
)
def test_sizes(any_device: str, shape: tuple[int, int]) -> None:
    rng = np.random.default_rng(3)
    field = HeightField(surfaces.terrain(rng, *shape), 1.0)
    points = around(rng, field.positions(), 200)
    center = points[:200].mean(axis=0)
    _, _, tracer = agree(
        any_device, lambda scene: scene.put_surface("ground", field), points, lights_around(center, 10.0)[:9]
    )
    assert len(probe.charts(tracer)[0]) == int(min(shape) > 1)


@pytest.mark.parametrize("kind", ["terrain", "image"])
def test_quads_with_some_corners(any_device: str, kind: str) -> None:
    """All sixteen of them, as quads of one surface with gutters in between: charts in an atlas."""
    rng = np.random.default_rng(4)
    valid = np.zeros((12, 12), bool)
    for pattern in range(16):
        row, column = 3 * (pattern // 4), 3 * (pattern % 4)
        valid[row : row + 2, column : column + 2] = np.array([pattern >> k & 1 for k in range(4)]).reshape(2, 2)
    positions = surfaces.depth_surface(rng, 12, 12)
    if kind == "terrain":
        positions = HeightField(surfaces.terrain(rng, 12, 12, 0.2), 1.0).positions()
    points = around(rng, np.where(valid[..., None], positions, np.nan), 700)
    lights = lights_around(positions.reshape(-1, 3).mean(axis=0), 5.0)
    states, _, tracer = agree(any_device, lambda scene: scene.put_surface("atlas", positions, valid), points, lights)
    assert len(probe.charts(tracer)[0]) == 1 and (states == 1).any()


@pytest.mark.parametrize("kind", ["terrain", "image"])
def test_rays_at_corners_of_boxes(any_device: str, kind: str) -> None:
    """Spikes of one position each, at corners of nodes: rays that just touch their tips, aimed with no room at all."""
    rng = np.random.default_rng(5)
    down, across = np.mgrid[:33, :33]
    spikes = (down % 4 == 0) & (across % 4 == 0)
    if kind == "terrain":
        positions = HeightField(np.where(spikes, 5.0 + rng.integers(0, 9, spikes.shape), 0.0), 1.0).positions()
    else:
        depth = np.where(spikes, 1.0 + rng.integers(0, 9, spikes.shape) / 8.0, 8.0)
        positions = np.stack([(across - 16) / 32.0 * depth, (down - 16) / 32.0 * depth, depth], axis=-1)
    tips = positions[spikes]
    shaken = 1e-7 * rng.uniform(-1, 1, tips.shape)
    for light in (PointLight("lamp", (0.25, 0.75, 20.0)), DirectionalLight("sun", (0.25, -0.75, -0.25))):
        away = tips - light.position if isinstance(light, PointLight) else np.broadcast_to(light.direction, tips.shape)
        points = np.concatenate([tips + away * far for far in (0.125, 1.0)] + [tips + shaken + away])
        states, _, _ = agree(any_device, lambda scene: scene.put_surface("spikes", positions), points, [light])
        assert (states == 1).mean() > 0.3


def test_positions_beside_their_places(any_device: str) -> None:
    """Each a thirtieth of a cell away, in any direction, and spikes among them that rays are aimed at."""
    rng = np.random.default_rng(6)
    positions = HeightField(np.zeros((33, 33)), 1.0).positions()
    positions[4:-4:4, 4:-4:4, 2] = 6.0
    positions[..., :2] += rng.uniform(-1, 1, (33, 33, 2)) / 30.0
    tips = positions[4:-4:4, 4:-4:4].reshape(-1, 3)
    towards = np.array([0.01, 0.02, 1.0])
    # A little below the tip, on the side that is beside its place.
    points = np.concatenate(
        [
            tips - towards * low + (dx, dy, 0.0)
            for low in (0.3, 3.0)
            for dx in (-0.02, 0, 0.02)
            for dy in (-0.02, 0, 0.02)
        ]
    )
    states, _, tracer = agree(
        any_device,
        lambda scene: scene.put_surface("ground", positions),
        points,
        [
            DirectionalLight("sun", -towards),
            PointLight("lamp", (16.0, -16.0, 50.0)),
            DirectionalLight("low", (1, 0, -1e-3)),
        ],
    )
    assert probe.charts(tracer)[0] == ["ground"] and 0.2 < (states == 1).mean() < 0.999


def test_corners_of_the_surface_from_very_far(any_device: str) -> None:
    """Level rays that touch the surface at one of its four corners and nowhere else, from up to a million times as far
    as it is wide, where a float32 number is no place in it any more."""
    rng = np.random.default_rng(12)
    positions = HeightField(rng.integers(0, 33, (33, 33)) / 1.0, 1.0).positions()
    middle, points, lights = positions[16, 16, :2], [], []
    for number, corner in enumerate(positions[row, column] for row in (0, 32) for column in (0, 32)):
        inside = np.append(np.sign(middle - corner[:2]), 0.0)
        for way in ((1, -1, 0), (-1, 1, 0), (3, -1, 0), (-1, 2, 0)):
            along = inside * way  # to the inside along one axis, to the outside along the other
            lights.append(PointLight(f"lamp {number} {way}", corner + along))
            points.append(corner - along * 2.0**18 * rng.integers(8, 32, (40, 1)))
    states, _, tracer = agree(
        any_device, lambda scene: scene.put_surface("ground", positions), np.concatenate(points), lights
    )
    hidden = [(states[k, 40 * k : 40 * (k + 1)] == 1).all() for k in range(len(lights))]
    assert probe.charts(tracer)[0] == ["ground"] and all(hidden)


def test_slopes_beside_their_places(any_device: str) -> None:
    """Ridges whose columns are a part of a cell away, one to the left and the next to the right: rays that begin just
    behind their slopes, which are planes, and would be in front of them if these were in their places."""
    positions = HeightField(np.zeros((33, 33)), 1.0).positions()
    positions[:, 4:-4:4, 2] = 6.0
    positions[:, 4:-4:8, 0] += 1.0 / 32.0
    positions[:, 8:-4:8, 0] -= 1.0 / 32.0
    slopes = [positions[4:-4, 4:-4:4] * (1.0 - u) + positions[4:-4, 4 + k : -4 + k : 4] * u
              for u in (0.125, 0.25, 0.5, 0.75) for k in (1, -1)]  # fmt: skip
    on = np.concatenate([0.5 * (each[1:] + each[:-1]) for each in slopes]).reshape(-1, 3)
    towards = np.array([1.0 / 64.0, 1.0 / 32.0, 1.0])
    points = np.concatenate([on + towards * far for far in (-0.125, -0.0625, 0.0625, 0.125)])
    suns = [DirectionalLight("up", -towards), DirectionalLight("down", towards)]
    states, _, tracer = agree(any_device, lambda scene: scene.put_surface("ridges", positions), points, suns)
    assert probe.charts(tracer)[0] == ["ridges"] and 0.3 < (states == 1).mean() < 0.7


def test_a_flat_surface_and_rays_in_its_plane(any_device: str) -> None:
    rng = np.random.default_rng(7)
    field = HeightField(np.zeros((20, 30)), 0.5)
    points = np.concatenate([rng.uniform((-3, -13, 0), (18, 3, 0), (300, 3)), field.positions().reshape(-1, 3)])
    points[:150, 2] = rng.choice([1e-9, -1e-9, 0.1, -0.1], 150)
    lights = [DirectionalLight("x", (1, 0, 0)), DirectionalLight("y", (0, -1, 0)), DirectionalLight("d", (1, -1, 0))]
    lights += [DirectionalLight("grazing", (1, 0, -1e-9)), DirectionalLight("down", (0, 0, -1))]
    places = [(7.25, -4.75, 0.0), (-5.0, 0.0, 0.0), (7.25, -4.75, 1e-9), (7.0, -5.0, -3.0)]
    lights += [PointLight(f"lamp {k}", place) for k, place in enumerate(places)]
    states, _, _ = agree(any_device, lambda scene: scene.put_surface("floor", field), points, lights)
    assert (states == 1).any(axis=1).sum() > 3


@pytest.mark.parametrize("kind", ["terrain", "image"])
def test_rays_along_rows_columns_and_diagonals(any_device: str, kind: str) -> None:
    rng = np.random.default_rng(8)
    z = rng.integers(0, 4, (16, 16)) / 4.0
    down, across = np.mgrid[:16, :16]
    if kind == "terrain":
        positions = HeightField(z, 1.0).positions()
    else:
        positions = np.stack([(across - 8) / 8.0, (down - 8) / 8.0, np.ones_like(z)], axis=-1) * (1.0 + z)[..., None]
    points = np.concatenate(
        [positions.reshape(-1, 3), positions.reshape(-1, 3) + (0, 0, 0.25 if kind == "terrain" else -0.25)]
    )
    flat = [(1, 0, 0), (-1, 0, 0), (0, 1, 0), (0, -1, 0), (1, 1, 0), (1, -1, 0), (-1, 1, 0), (-1, -1, 0)]
    lights: list[Any] = [DirectionalLight(f"sun {k}", way) for k, way in enumerate(flat)]
    # From one position to another: along the rows and columns that they share, through corners of quads.
    lights += [
        PointLight(f"lamp {k}", positions[r, c] + (0, 0, 0.5))
        for k, (r, c) in enumerate([(0, 0), (7, 7), (15, 3), (4, 0)])
    ]
    states, _, _ = agree(any_device, lambda scene: scene.put_surface("ground", positions), points, lights)
    assert (states == 1).mean() > 0.1


def test_samples_far_away(any_device: str) -> None:
    rng = np.random.default_rng(9)
    positions = {
        "terrain": HeightField(surfaces.terrain(rng, 12, 12), 1.0).positions(),
        "image": surfaces.depth_surface(rng, 12, 12),
    }
    ways = rng.normal(size=(200, 3))
    ways /= np.linalg.norm(ways, axis=1, keepdims=True)
    for each in positions.values():
        middle = each.reshape(-1, 3).mean(axis=0)
        points = np.concatenate([middle + ways * far for far in (1.0, 1e3, 1e5, 1e7, 1e15)])
        light = PointLight("lamp", middle + (0.1, 0.2, 0.3))
        states, _, _ = agree(any_device, lambda scene, each=each: scene.put_surface("ground", each), points, [light])
        assert (states == 1).any()


def test_rays_that_touch_peaks_from_far_away(any_device: str) -> None:
    """From as far away as rays are followed through a chart at all, so that a small part of their ways is long."""
    rng = np.random.default_rng(12)
    z = np.zeros((41, 41))
    peaks = rng.permutation(1681)[:30]
    z.reshape(-1)[peaks] = rng.integers(10, 41, 30)
    field = HeightField(z, 1.0)
    tips = field.positions().reshape(-1, 3)[peaks]
    hidden = []
    for tip, (x, y) in zip(tips[:10], rng.normal(size=(10, 2)), strict=True):
        way = np.array([x, y, 0.1]) / np.sqrt(x * x + y * y + 0.01)
        lamp = PointLight("lamp", tip - 2.0 * way)
        lower = np.array([[0.0, 0.0, -1e-6], [0.0, 0.0, -1e-3], [0.0, 0.0, 1.0], [0.0, 0.0, 0.0]])
        points = np.concatenate([tip + way * far + lower for far in (1e3, 1e5, 3e6, 8e6, 9e6, 1e7, 1.1e7)])
        states, counters, _ = agree(any_device, lambda scene: scene.put_surface("ground", field), points, [lamp])
        hidden.append((states == 1).mean())
        assert counters["leaf_tests"] < 100 * len(points), "all quads are shown"
    assert 0.2 < np.mean(hidden) < 1.0


def test_a_chart_that_has_lost_its_places_shows_everything(any_device: str) -> None:
    rng = np.random.default_rng(10)
    field = HeightField(surfaces.terrain(rng, 20, 20), 1.0)
    points = around(rng, field.positions(), 300)
    lights = lights_around(np.array([10.0, -10.0, 0.0]), 10.0)
    states, counters, tracer = agree(any_device, lambda scene: scene.put_surface("ground", field), points, lights)
    probe.lose_places(tracer)
    traced = probe.trace_points(tracer, points, lights)
    assert np.array_equal(traced.states, states) and traced.counters["leaf_tests"] > 5 * counters["leaf_tests"]


@pytest.mark.parametrize("queue", [1, 50_000])
def test_meshes_and_folded_surfaces_beside_terrain(any_device: str, queue: int) -> None:
    rng = np.random.default_rng(11)
    ground = HeightField(surfaces.terrain(rng, 30, 30), 1.0)
    cloth = surfaces.depth_surface(rng, 10, 10) + (10.0, -15.0, 0.0)
    cloth[..., 0] = np.abs(cloth[..., 0] - 10.0) + 10.0
    rocks = ground.positions().reshape(-1, 3)[rng.integers(0, 900, 40), None] + rng.normal(size=(40, 3, 3))

    def setup(scene: Scene) -> None:
        scene.put("rocks", rocks.reshape(-1, 3), np.arange(120).reshape(-1, 3))
        scene.put_surface("ground", ground)
        scene.put_surface("cloth", cloth)

    points = np.concatenate([around(rng, ground.positions(), 400), rocks.reshape(-1, 3)])
    lights = lights_around(np.array([15.0, -15.0, 1.0]), 8.0)
    for cull in (False, True):
        _, _, tracer = agree(any_device, setup, points, lights, 0.0, cull, queue_capacity=queue)
    assert probe.charts(tracer)[0] == ["ground"]


def test_many_surfaces_and_rooms_that_are_full(any_device: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(charts, "MOST_CHARTS", 5)
    rng = np.random.default_rng(12)

    def setup(scene: Scene) -> None:
        for k in range(9):
            field = HeightField(
                surfaces.terrain(np.random.default_rng(k), 6, 6), 1.0, (7.0 * (k % 3), -7.0 * (k // 3), 0.0)
            )
            scene.put_surface(f"tile {k}", field, pose=turned(0.1 * k, (0, 0, 1), (0, 0, 0)))

    points = rng.uniform((-3, -25, -3), (25, 3, 3), (600, 3))
    _, _, tracer = agree(any_device, setup, points, lights_around(np.array([9.0, -9.0, 1.0]), 8.0))
    assert len(probe.charts(tracer)[0]) == 5


def test_sequences_of_unlike_frames(any_device: str) -> None:
    """Surfaces and meshes that come, go, change their size, deform, move and lose positions, in random order."""
    rng = np.random.default_rng(13)
    ours = surfaces.tracer(any_device, "height_field", threads=2)
    theirs = surfaces.tracer(any_device, "brute_force")
    names, seen = ["ground", "image", "cloth"], set()
    for _ in range(40):
        name, what = names[rng.integers(0, 3)], rng.integers(0, 7)
        rows, columns = rng.integers(2, 20, 2)
        z = surfaces.terrain(rng, rows, columns)
        z[rng.random(z.shape) < rng.choice([0.0, 0.1])] = np.nan
        surface: Any = HeightField(z, 1.0, (*rng.uniform(-5, 5, 2), 0.0))
        if name == "image":
            surface = surfaces.depth_surface(rng, rows, columns) * 3.0
        elif name == "cloth":
            surface = rng.normal(size=(rows, columns, 3)) * 5.0
        pose = turned(rng.uniform(0, 3), (0, 0, 1), tuple(rng.uniform(-3, 3, 3)))
        soup, light = rng.normal(size=(9, 3)) * 4.0, rng.uniform(-15, 15, 3)
        for scene in (ours.scene, theirs.scene):
            if what == 0:
                scene.put("soup", soup, np.arange(9).reshape(-1, 3))
            elif what == 1 and name in scene:
                scene.remove(name)
            elif what == 2 and name in scene:
                scene.move(name, pose)
            elif what == 3 and name in scene:
                grid = scene[name].grid
                assert grid is not None
                scene.deform_surface(name, np.nan_to_num(scene[name].vertices.reshape(*grid, 3)) + (0.0, 0.0, 0.5))
            elif what == 4 and "soup" in scene:
                scene.remove("soup")
            else:
                scene.put_surface(name, surface, pose=pose)
        points = rng.uniform(-12, 12, (int(rng.choice([3, 500])), 3))
        lights = [PointLight("lamp", light), DirectionalLight("sun", light)]
        states = [probe.trace_points(each, points, lights, 0.01).states for each in (ours, theirs)]
        assert np.array_equal(*states)
        seen |= set(probe.charts(ours)[0])
    assert seen == {"ground", "image"}


def test_images_spheres_and_a_second_pipeline(any_device: str) -> None:
    """Depth images of a surface, traced with point and sphere lights, and verified."""
    tracers = [surfaces.tracer(any_device, name) for name in ("height_field", "light_grid", "brute_force")]
    pose = geometry.look_at((8.0, -20.0, 14.0), (8.0, -8.0, 0.0), (0.0, 0.0, 1.0))
    camera = Camera(60, 40, 40.0, 40.0, 29.5, 19.5, pose)
    lights = [PointLight("lamp", (8.0, -8.0, 9.0)), SphereLight("bulb", (2.0, -3.0, 8.0), 0.5, samples=5)]
    frames = []
    for tracer in tracers:
        tracer.scene.put_surface("ground", HeightField(surfaces.terrain(np.random.default_rng(14), 18, 18), 1.0))
        depth, _ = render_depth(tracer.scene, camera, device=any_device)
        frames.append(tracer.trace(depth, camera, lights, 0.05))
    assert np.isfinite(depth).mean() > 0.4
    for frame in frames[:2]:
        assert frame.differing(frames[2]) == 0
        assert np.array_equal(frame.visibility("bulb"), frames[2].visibility("bulb"), equal_nan=True)
    assert tracers[0].verify(depth, camera, lights, 0.05, against="light_grid") == 0
    assert tracers[1].verify(depth, camera, lights, 0.05, against="height_field") == 0


@pytest.mark.parametrize("sequence", ["livingroom1", "redkitchen"])
def test_recorded_depth_images_as_their_own_occluders(any_device: str, sequence: str) -> None:
    depth, k, pose = data.frame(sequence, 0)
    u, _, v = np.linalg.svd(pose[:3, :3])
    pose[:3, :3] = u @ v  # some of them are given with four digits
    z = depth[::8, ::8] / 1000.0
    valid = (z > 0) & (z < 60)
    down, across = np.mgrid[: depth.shape[0] : 8, : depth.shape[1] : 8]
    positions = np.stack([(across - k[0, 2]) / k[0, 0] * z, (down - k[1, 2]) / k[1, 1] * z, z], axis=-1)
    points = moved(pose, positions[valid][::3])
    lights = [
        PointLight(f"lamp {n}", moved(pose, np.array(each)))
        for n, each in enumerate([(0, 0, 0), (0.4, -0.3, 0), (1, 0, 1.5), (0, 0, 9)])
    ]
    states, _, tracer = agree(
        any_device, lambda scene: scene.put_surface("image", positions, valid, pose), points, lights, 0.02
    )
    assert probe.charts(tracer)[0] == ["image"] and 0.05 < (states == 1).mean() < 0.9
