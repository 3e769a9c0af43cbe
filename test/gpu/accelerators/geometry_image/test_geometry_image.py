# SPDX-License-Identifier: Apache-2.0
"""Geometry images against brute_force: surfaces of every kind and size, masks, rays in the way of everything, meshes
beside them, sequences of unlike frames, and the order of their nodes."""

from __future__ import annotations

from typing import Any

import data
import numpy as np
import probe
import probe_accelerators
import pytest
import surfaces
from surfaces import around, lights_around, moved, turned

from shadow_tracer import (
    Camera,
    DirectionalLight,
    HeightField,
    PointLight,
    Scene,
    ShadowTracer,
    SphereLight,
    render_depth,
)
from shadow_tracer.gpu.accelerators.geometry_image import images

pytestmark = probe.in_both_forms


def _agree(device: str, setup: surfaces.Setup, *arguments: Any, **more: Any) -> tuple[np.ndarray, dict[str, int], Any]:
    return surfaces.agree(device, setup, *arguments, pipeline="geometry_image", **more)


def _cloth(rng: np.random.Generator, rows: int, columns: int) -> np.ndarray:
    """(R, C, 3) positions of a surface that is folded over itself, its quads too: from either side of a diagonal one
    triangle lies over the other one."""
    down, across = np.mgrid[:rows, :columns]
    swing = np.abs(across % 10 - 5.0) + np.where(down % 3 == 1, 0.75, 0.0)
    z = 0.3 * down + 0.5 * (across // 5) + rng.integers(-200, 201, (rows, columns)) / 1000.0
    return np.stack([swing, 0.5 * down + 0.1 * (across % 2), z], axis=-1)


def _ball(rows: int, columns: int) -> np.ndarray:
    """(R, C, 3) positions of a closed surface: its first and last column are the same, its first and last row points;
    of sums, quotients and roots alone."""
    s = np.linspace(-1.0, 1.0, rows)[:, None]
    t = np.abs((np.arange(columns) / (columns - 1) * 4.0 + 1.0) % 4.0 - 2.0) - 1.0
    u = np.abs(np.arange(columns) / (columns - 1) * 4.0 % 4.0 - 2.0) - 1.0
    flat = np.sqrt(1.0 - s * s)
    return np.stack(np.broadcast_arrays(flat * u, flat * t, s), axis=-1)


@pytest.mark.parametrize("cull", [False, True])
@pytest.mark.parametrize("offset", [(0.0, 0.0, 0.0), (5e5, 4e6, 100.0)])
def test_terrain(any_device: str, offset: tuple[float, float, float], cull: bool) -> None:
    rng = np.random.default_rng(1)
    z = surfaces.terrain(rng, 41, 50)
    z[10:13, 20:30], z[30, 31], z[0, 0] = np.nan, np.nan, np.nan
    field = HeightField(z, (1.0, 1.3), origin=offset)
    lights = lights_around(np.array(offset) + (30, -20, 0), 30.0)
    points = around(rng, field.positions(), 300)
    states, _, tracer = _agree(
        any_device, lambda scene: scene.put_surface("ground", field), points, lights, 0.01 if cull else 0.0, cull
    )
    assert probe_accelerators.images(tracer) == ["ground"] and 0.1 < (states == 1).mean() < 0.9


@pytest.mark.parametrize("kind", ["folded", "wild", "closed"])
def test_folded_surfaces(any_device: str, kind: str) -> None:
    rng = np.random.default_rng(2)
    positions = {
        "folded": _cloth(rng, 20, 31),
        "wild": rng.normal(size=(14, 15, 3)) * 3.0,
        "closed": 4.0 * _ball(21, 33),
    }[kind]
    points = around(rng, positions, 300)
    middle = positions.reshape(-1, 3).mean(axis=0)
    for cull in (False, True):
        states, _, tracer = _agree(
            any_device,
            lambda scene: scene.put_surface("cloth", positions, pose=turned(0.5, (1, 2, 3), (1, 0, 0))),
            moved(turned(0.5, (1, 2, 3), (1, 0, 0)), points),
            lights_around(middle, 5.0),
            0.0,
            cull,
        )
        assert probe_accelerators.images(tracer) == ["cloth"] and (states == 1).any()


def test_a_closed_surface_has_no_cracks(any_device: str) -> None:
    """A light within: from outside nothing of it is seen, through corners and edges where its ends meet either."""
    positions = 4.0 * _ball(17, 25)
    ways = positions.reshape(-1, 3)
    points = np.concatenate([1.25 * ways, 1.5 * 0.5 * (ways[1:] + ways[:-1])])
    points = points[np.linalg.norm(points, axis=1) > 4.5]
    states, _, _ = _agree(
        any_device, lambda scene: scene.put_surface("ball", positions), points, [PointLight("lamp", (0.0, 0.0, 0.0))]
    )
    assert (states == 1).all()


@pytest.mark.parametrize(
    "shape",
    [(1, 1), (1, 2), (2, 1), (2, 2), (2, 3), (3, 2), (6, 5), (17, 18), (33, 34), (513, 2), (2, 513), (5, 101), (66, 9)],
)
def test_sizes(any_device: str, shape: tuple[int, int]) -> None:
    rng = np.random.default_rng(3)
    field = HeightField(surfaces.terrain(rng, *shape), 1.0)
    points = around(rng, field.positions(), 150)
    lights = lights_around(points[:150].mean(axis=0), 10.0)[:9]
    _, _, tracer = _agree(any_device, lambda scene: scene.put_surface("ground", field), points, lights)
    assert len(probe_accelerators.images(tracer)) == int(min(shape) > 1)


def test_every_quad_has_a_node_and_nodes_hold_what_is_below() -> None:
    """All sizes up to 40 x 40 and some larger ones: the room for nodes, and that nothing is far larger than it need
    be."""
    sizes = [(r, c) for r in range(1, 41) for c in range(1, 41)]
    sizes += [(257, 257), (1025, 33), (33, 1025), (479, 639), (1, 5000), (5000, 3), (4097, 4097), (129, 300)]
    for rows, columns in sizes:
        layout, quads = images.layout_of(rows, columns), rows * columns
        assert quads <= layout.keys <= 1.25**3 * quads, (rows, columns)
        assert layout.nodes[-1] == 1
        assert sum(layout.nodes) <= 2.625 * quads + 16, (rows, columns)
    assert images.layout_of(512, 512).nodes == tuple(4**k for k in range(9, -1, -1))


@pytest.mark.parametrize("shape", [(9, 9), (14, 30), (30, 7), (2, 40)])
def test_nodes_are_the_least_and_largest_of_their_quads(any_device: str, shape: tuple[int, int]) -> None:
    """What stands on the device, with holes: each quad that has a triangle once, each box as tight as may be."""
    rng = np.random.default_rng(4)
    positions, valid = rng.normal(size=(*shape, 3)), rng.random(shape) > 0.2
    tracer = surfaces.tracer(any_device, "geometry_image")
    tracer.scene.put_surface("cloth", positions, valid)
    tracer.occluded(np.zeros((1, 3)), PointLight("lamp", (1.0, 2.0, 3.0)))
    levels, center, extent = probe_accelerators.mip_map(tracer)
    positions[~valid] = np.nan
    corners = np.stack([positions[:-1, :-1], positions[:-1, 1:], positions[1:, :-1], positions[1:, 1:]], axis=2)
    corners = corners.reshape(-1, 4, 3)
    corners = corners[np.isfinite(corners[..., 0]).sum(axis=1) >= 3]
    wanted = np.concatenate([np.nanmin(corners, axis=1), np.nanmax(corners, axis=1)], axis=1)
    boxes = levels[0][levels[0][:, 0] < 1.01]
    found = boxes * extent + np.tile(center, 2)
    assert np.isfinite(levels[0]).all() and len(found) == len(wanted)
    order = [np.lexsort(each[:, ::-1].round(4).T) for each in (found, wanted)]
    off = found[order[0]] - wanted[order[1]]
    pad = 2.0**-19 * extent
    assert (off[:, :3] <= -0.9 * pad).all() and (off[:, 3:] >= 0.9 * pad).all() and (np.abs(off) <= 1.1 * pad).all()
    for below, above in zip(levels[:-1], levels[1:], strict=True):
        for k, node in enumerate(above):
            children = below[4 * k : 4 * k + 4]
            children = children[children[:, 0] < 1.01]
            if len(children):
                assert np.array_equal(node[:3], children[:, :3].min(axis=0))
                assert np.array_equal(node[3:], children[:, 3:].max(axis=0))
            else:
                assert node[0] > 1.01


@pytest.mark.parametrize("kind", ["terrain", "cloth"])
def test_quads_with_some_corners(any_device: str, kind: str) -> None:
    """All sixteen of them, as quads of one surface with gutters in between: charts in an atlas."""
    rng = np.random.default_rng(5)
    valid = np.zeros((12, 12), bool)
    for pattern in range(16):
        row, column = 3 * (pattern // 4), 3 * (pattern % 4)
        valid[row : row + 2, column : column + 2] = np.array([pattern >> k & 1 for k in range(4)]).reshape(2, 2)
    positions = _cloth(rng, 12, 12)
    if kind == "terrain":
        positions = HeightField(surfaces.terrain(rng, 12, 12, 0.2), 1.0).positions()
    # Whatever stands where nothing is valid: it is nowhere looked at.
    given = np.where(valid[..., None], positions, rng.choice([np.nan, np.inf, 1e300, 0.0], (12, 12, 1)))
    points = around(rng, np.where(valid[..., None], positions, np.nan), 500)
    lights = lights_around(positions.reshape(-1, 3).mean(axis=0), 5.0)
    states, _, _ = _agree(any_device, lambda scene: scene.put_surface("atlas", given, valid), points, lights)
    assert (states == 1).any()


def test_a_surface_without_a_valid_quad(any_device: str) -> None:
    """Alone, then beside a mesh, then with its positions."""
    tracer, points = surfaces.tracer(any_device, "geometry_image"), np.array([(1.0, 1.0, -1.0), (9.0, 9.0, 9.0)])
    light, positions = PointLight("lamp", (1.0, 1.0, 5.0)), np.zeros((3, 3, 3))
    positions[..., :2] = np.moveaxis(np.mgrid[:3, :3], 0, -1) + 0.125
    tracer.scene.put_surface("sheet", positions, np.eye(3) > 0)
    assert not tracer.occluded(points, light).any()
    tracer.scene.put("roof", [(0, 0, 1), (4, 0, 1), (0, 4, 1)], [(0, 1, 2)])
    assert tracer.occluded(points, light).tolist() == [True, False]
    tracer.scene.remove("roof")
    assert not tracer.occluded(points, light).any()
    tracer.scene.deform_surface("sheet", positions, np.ones((3, 3), bool))
    assert tracer.occluded(points, light).tolist() == [True, False]


def test_rays_at_corners_of_boxes(any_device: str) -> None:
    """Spikes of one position each, at corners of nodes: rays that just touch their tips, aimed with no room at all."""
    rng = np.random.default_rng(6)
    down, across = np.mgrid[:33, :33]
    spikes = (down % 4 == 0) & (across % 4 == 0)
    z = np.where(spikes, 5.0 + rng.integers(0, 900, spikes.shape) / 100.0, 0.0)
    tips = HeightField(z, 0.7).positions()[spikes]
    lights = (PointLight("lamp", (0.25, 0.75, 20.0)), DirectionalLight("sun", (0.25, -0.75, -0.25)))
    for light in (*lights, PointLight("side", (40.0, 3.0, 9.0)), PointLight("far", (3.0, -70.0, 8.0))):
        away = tips - light.position if isinstance(light, PointLight) else np.broadcast_to(light.direction, tips.shape)
        points = np.concatenate([tips + away * far for far in (0.125, 0.25, 1.0)])
        field = HeightField(z, 0.7)
        states, _, _ = _agree(any_device, lambda scene, it=field: scene.put_surface("spikes", it), points, [light])
        assert (states == 1).mean() > 0.1


def test_flat_boxes_and_rays_in_their_plane(any_device: str) -> None:
    """Floors and walls along all axes, at a height that float32 does not have."""
    rng = np.random.default_rng(7)
    flat = HeightField(np.full((20, 30), 0.1), 0.5).positions()
    points = np.concatenate([rng.uniform((-3, -13, 0), (18, 3, 0), (200, 3)), flat[::2, ::3].reshape(-1, 3)])
    points[:200, 2] = 0.1 + rng.choice([0.0, 1e-9, -1e-9, 0.1, -0.1], 200)
    ways = [(1, 0, 0), (0, -1, 0), (1, -1, 0), (1, 0, -1e-9), (0, 0, -1)]
    places = [(7.25, -4.75, 0.1), (-5.0, 0.0, 0.1), (7.25, -4.75, 0.1 + 1e-9), (7.0, -5.0, -3.0)]
    for turn in range(3):
        shown, ask = np.roll(flat, turn, axis=-1), np.roll(points, turn, axis=-1)
        lights: list[Any] = [DirectionalLight(f"sun {k}", np.roll(way, turn)) for k, way in enumerate(ways)]
        lights += [PointLight(f"lamp {k}", np.roll(place, turn)) for k, place in enumerate(places)]
        states, _, _ = _agree(any_device, lambda scene, it=shown: scene.put_surface("floor", it), ask, lights)
        assert (states == 1).any(axis=1).sum() > 3


@pytest.mark.parametrize("kind", ["terrain", "image"])
def test_rays_along_rows_columns_and_diagonals(any_device: str, kind: str) -> None:
    """Also lights at the optical centre of a depth image, and in the plane of that."""
    rng = np.random.default_rng(8)
    z = rng.integers(0, 4, (16, 16)) / 4.0
    down, across = np.mgrid[:16, :16]
    if kind == "terrain":
        positions = HeightField(z, 1.0).positions()
    else:
        positions = np.stack([(across - 8) / 8.0, (down - 8) / 8.0, np.ones_like(z)], axis=-1) * (1.0 + z)[..., None]
    beside = positions.reshape(-1, 3) + (0, 0, 0.25 if kind == "terrain" else -0.25)
    points = np.concatenate([positions.reshape(-1, 3), beside])
    flat = [(1, 0, 0), (-1, 0, 0), (0, 1, 0), (0, -1, 0), (1, 1, 0), (1, -1, 0), (-1, 1, 0), (-1, -1, 0)]
    lights: list[Any] = [DirectionalLight(f"sun {k}", way) for k, way in enumerate(flat)]
    at = [positions[r, c] + (0, 0, 0.5) for r, c in [(0, 0), (7, 7), (15, 3), (4, 0)]]
    at += [np.zeros(3), np.array((1.0, 0.0, 0.0)), np.array((0.1, 0.0, -2.0))]
    lights += [PointLight(f"lamp {k}", place) for k, place in enumerate(at)]
    states, _, _ = _agree(any_device, lambda scene: scene.put_surface("ground", positions), points, lights)
    assert (states == 1).mean() > 0.1


def test_samples_far_away(any_device: str) -> None:
    rng = np.random.default_rng(9)
    positions = _cloth(rng, 12, 12)
    middle, ways = positions.reshape(-1, 3).mean(axis=0), rng.normal(size=(150, 3))
    ways /= np.linalg.norm(ways, axis=1, keepdims=True)
    points = np.concatenate([middle + ways * far for far in (1.0, 1e3, 1e5, 1e7, 1e9, 1e15)])
    light = PointLight("lamp", middle + (0.1, 0.2, 0.3))
    states, _, _ = _agree(any_device, lambda scene: scene.put_surface("cloth", positions), points, [light])
    assert (states == 1).any()


@pytest.mark.parametrize("level", [1, 3])
def test_a_level_of_detail_is_another_world_with_the_same_bits(any_device: str, level: int) -> None:
    """The ball's ends still meet."""
    positions = 4.0 * _ball(18, 31)
    ways = positions.reshape(-1, 3)
    points = np.concatenate([1.25 * ways, 0.8 * ways, 2.0 * np.roll(ways, 7, axis=0)])
    lights = [PointLight("lamp", (0.0, 0.0, 0.0)), PointLight("side", (3.0, 9.0, 1.0)), surfaces.sun(20.0, 200.0)]
    states, _, tracer = _agree(
        any_device, lambda scene: scene.put_surface("ball", positions, level=level), points, lights
    )
    outside = np.linalg.norm(points, axis=1) > 4.5
    assert tracer.scene["ball"].grid == {1: (10, 16), 3: (4, 5)}[level] and (states[0, outside] == 1).all()


@pytest.mark.parametrize("queue", [1, 50_000])
def test_meshes_beside_surfaces(any_device: str, queue: int) -> None:
    rng = np.random.default_rng(11)
    ground = HeightField(surfaces.terrain(rng, 30, 30), 1.0)
    cloth = _cloth(rng, 12, 12) + (10.0, -15.0, 0.0)
    rocks = ground.positions().reshape(-1, 3)[rng.integers(0, 900, 40), None] + rng.normal(size=(40, 3, 3))

    def setup(scene: Scene) -> None:
        scene.put("rocks", rocks.reshape(-1, 3), np.arange(120).reshape(-1, 3))
        scene.put_surface("ground", ground)
        scene.put_surface("cloth", cloth)
        scene.put_surface("line", np.zeros((1, 5, 3)))

    points = np.concatenate([around(rng, ground.positions(), 200), rocks.reshape(-1, 3)])
    lights = lights_around(np.array([15.0, -15.0, 1.0]), 8.0)
    lights[3] = DirectionalLight("without ground", (1, 0.2, -0.3), ignore=["ground"])
    lights[9] = PointLight("without rocks", (15.0, -15.0, 9.0), ignore=["rocks"])
    for cull in (False, True):
        _, _, tracer = _agree(any_device, setup, points, lights, 0.0, cull, queue_capacity=queue)
    assert probe_accelerators.images(tracer) == ["ground", "cloth"]


def test_more_surfaces_than_there_is_room_for(any_device: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(images, "MOST_IMAGES", 5)
    rng = np.random.default_rng(12)

    def setup(scene: Scene) -> None:
        for k in range(9):
            z = surfaces.terrain(np.random.default_rng(k), 6, 6)
            field = HeightField(z, 1.0, (7.0 * (k % 3), -7.0 * (k // 3), 0.0))
            scene.put_surface(f"tile {k}", field, pose=turned(0.1 * k, (0, 0, 1), (0, 0, 0)))

    points = rng.uniform((-3, -25, -3), (25, 3, 3), (400, 3))
    _, _, tracer = _agree(any_device, setup, points, lights_around(np.array([9.0, -9.0, 1.0]), 8.0))
    assert len(probe_accelerators.images(tracer)) == 5


def _change(rng: np.random.Generator, scenes: tuple[Scene, ...]) -> None:
    """One surface or mesh comes, goes, deforms, moves or loses positions, in all of the scenes."""
    name, what = ["ground", "image", "cloth"][rng.integers(0, 3)], rng.integers(0, 8)
    rows, columns = rng.integers(2, 20, 2)
    z = surfaces.terrain(rng, rows, columns)
    z[rng.random(z.shape) < rng.choice([0.0, 0.1])] = np.nan
    surface: Any = HeightField(z, 1.0, (*rng.uniform(-5, 5, 2), 0.0))
    if name != "ground":
        surface = 3.0 * (surfaces.depth_surface if name == "image" else _cloth)(rng, rows, columns)
    pose = turned(rng.uniform(0, 3), (0, 0, 1), tuple(rng.uniform(-3, 3, 3)))
    soup, shift = rng.normal(size=(9, 3)) * rng.choice([0.5, 4.0, 4000.0]), rng.normal(size=3)
    holes = rng.random() < 0.3
    for scene in scenes:
        if what == 0:
            scene.put("soup", soup, np.arange(9).reshape(-1, 3))
        elif what == 1 and name in scene:
            scene.remove(name)
        elif what == 2 and name in scene:
            scene.move(name, pose)
        elif what in (3, 4) and name in scene:
            grid = scene[name].grid
            assert grid is not None
            positions = np.nan_to_num(scene[name].vertices.reshape(*grid, 3)) + shift
            valid = np.arange(grid[0] * grid[1]).reshape(grid) % 7 != 3 if holes else None
            scene.deform_surface(name, positions, valid)
        elif what == 5 and "soup" in scene:
            scene.remove("soup")
        else:
            scene.put_surface(name, surface, pose=pose)


@pytest.mark.parametrize("threads", [1, 2])
def test_sequences_of_unlike_frames(any_device: str, threads: int) -> None:
    rng = np.random.default_rng(13 + threads)
    ours = [surfaces.tracer(any_device, "geometry_image", threads=threads, max_sample_sets=2) for _ in range(2)]
    theirs, seen = surfaces.tracer(any_device, "brute_force"), set()
    for _ in range(40):
        _change(rng, (ours[0].scene, ours[1].scene, theirs.scene))
        light = rng.uniform(-15, 15, 3)
        points = rng.uniform(-12, 12, (int(rng.choice([3, 300])), 3))
        lights = [
            PointLight("lamp", light),
            DirectionalLight("sun", light, ignore=[["ground"], []][rng.integers(0, 2)]),
        ]
        tracer, samples = ours[rng.integers(0, 2)], str(rng.choice(["", "b"]))
        found = probe.trace_points(tracer, points, lights, 0.01, samples=samples)
        expected = probe.trace_points(theirs, points, lights, 0.01)
        assert np.array_equal(found.states, expected.states)
        for name in ("triangles", "degenerate", "culled"):
            assert found.counters[name] == expected.counters[name], name
        seen |= set(probe_accelerators.images(tracer))
    assert seen == {"ground", "image", "cloth"}


def test_boxes_are_made_for_what_has_changed_and_nothing_else(any_device: str) -> None:
    tracer = surfaces.tracer(any_device, "geometry_image")
    made = probe_accelerators.count_mip_maps(tracer)
    ground, light = HeightField(2.0 * np.eye(9), 1.0), PointLight("lamp", (3.0, -3.0, 5.0))

    def trace(change: Any) -> int:
        before = len(made)
        change()
        tracer.occluded(np.zeros((1, 3)), light)
        return len(made) - before

    scene, rock = tracer.scene, np.array([(1.0, -1.0, 0.0), (2.0, -1.0, 0.0), (1.0, -2.0, 1.0)])
    assert trace(lambda: scene.put_surface("ground", ground)) == 1
    assert trace(lambda: None) == 0
    assert trace(lambda: scene.put_surface("hill", HeightField(np.ones((5, 5)), 1.0))) == 1
    assert trace(lambda: scene.put("rock", rock, [(0, 1, 2)])) == 0
    assert trace(lambda: scene.deform_surface("hill", HeightField(np.full((5, 5), 0.5), 1.0))) == 1
    assert trace(lambda: scene.put("rock", rock + 40.0, [(0, 1, 2)])) == 2, "the scene's box is another one"
    assert trace(lambda: scene.remove("rock")) == 2, "and again, too large to be kept"
    assert trace(lambda: scene.remove("ground")) == 1, "the hill has another place"


def test_what_is_damaged_is_made_once_more(any_device: str) -> None:
    """``verify`` promises it: after a difference nothing is used that was kept."""
    tracer = surfaces.tracer(any_device, "geometry_image")
    tracer.scene.put_surface("cloth", _cloth(np.random.default_rng(1), 12, 12))
    points, light = np.random.default_rng(1).uniform((-2, -2, -2), (7, 7, 7), (300, 3)), PointLight("lamp", (2, 3, 9))
    right = probe.trace_points(tracer, points, [light]).states
    probe_accelerators.spoil_mip_maps(tracer)
    assert not np.array_equal(probe.trace_points(tracer, points, [light]).states, right), "it was kept, and is used"
    probe.forget(tracer, "")
    assert np.array_equal(probe.trace_points(tracer, points, [light]).states, right)


def test_depth_images_spheres_and_a_second_pipeline(any_device: str) -> None:
    """Depth images of a surface, traced with point and sphere lights, and verified."""
    tracers = [surfaces.tracer(any_device, name) for name in ("geometry_image", "light_grid", "brute_force")]
    pose = np.array([(1.0, 0, 0, 3.0), (0, 1.0, 0, 3.0), (0, 0, 1.0, -6.0), (0, 0, 0, 1.0)])
    camera = Camera(60, 40, 40.0, 40.0, 29.5, 19.5, pose)
    lights = [PointLight("lamp", (2.0, 2.0, -4.0)), SphereLight("bulb", (0.0, 5.0, -3.0), 0.5, samples=5)]
    frames = []
    for tracer in tracers:
        tracer.scene.put_surface("cloth", _cloth(np.random.default_rng(14), 18, 18))
        depth, _ = render_depth(tracer.scene, camera, device=any_device)
        frames.append(tracer.trace(depth, camera, lights, 0.05))
    assert np.isfinite(depth).mean() > 0.2
    for frame in frames[:2]:
        assert frame.differing(frames[2]) == 0
        assert np.array_equal(frame.visibility("bulb"), frames[2].visibility("bulb"), equal_nan=True)
    assert tracers[0].verify(depth, camera, lights, 0.05, against="light_grid") == 0


@pytest.mark.parametrize("sequence", ["livingroom1", "redkitchen"])
def test_recorded_depth_images_as_their_own_occluders(any_device: str, sequence: str) -> None:
    depth, k, pose = data.frame(sequence, 0)
    u, _, v = np.linalg.svd(pose[:3, :3])
    pose[:3, :3] = u @ v  # some of them are given with four digits
    z = depth[::8, ::8] / 1000.0
    valid = (z > 0) & (z < 60)
    down, across = np.mgrid[: depth.shape[0] : 8, : depth.shape[1] : 8]
    positions = np.stack([(across - k[0, 2]) / k[0, 0] * z, (down - k[1, 2]) / k[1, 1] * z, z], axis=-1)
    points = moved(pose, positions[valid][::6])
    places = [(0, 0, 0), (0.4, -0.3, 0), (1, 0, 1.5), (0, 0, 9)]
    lights = [PointLight(f"lamp {n}", moved(pose, np.array(each))) for n, each in enumerate(places)]
    states, _, _ = _agree(
        any_device, lambda scene: scene.put_surface("image", positions, valid, pose), points, lights, 0.02
    )
    assert 0.05 < (states == 1).mean() < 0.9


def test_a_ray_that_meets_no_box_looks_at_the_roots_alone(any_device: str) -> None:
    tracer: ShadowTracer = surfaces.tracer(any_device, "geometry_image")
    for k in range(3):
        tracer.scene.put_surface(f"tile {k}", HeightField(np.zeros((9, 9)), 1.0, (20.0 * k, 0.0, float(k))))
    found = probe.trace_points(tracer, np.array([(10.0, -20.0, 1.0)]), [PointLight("lamp", (10.0, 5.0, 1.0))])
    assert (found.counters["nodes_visited"], found.counters["leaf_tests"]) == (3, 0)
    found = probe.trace_points(tracer, np.array([(0.25, -0.125, -9.0)]), [PointLight("lamp", (0.25, -0.125, 9.0))])
    assert (found.counters["nodes_visited"], found.counters["leaf_tests"]) == (4, 2), "straight down to the first quad"
