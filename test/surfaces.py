# SPDX-License-Identifier: Apache-2.0
"""Terrain and depth images for tests, and tracers of a pipeline beside brute_force over them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import probe

from shadow_tracer import Bounds, DirectionalLight, PointLight, Scene, ShadowTracer, SpotLight

Setup = Callable[[Scene], object]
BOUNDS = {"max_triangles": 12_000, "max_rays": 30_000, "max_lights": 16, "grid_entries": 50_000}


def terrain(rng: np.random.Generator, rows: int, columns: int, rough: float = 1.0) -> np.ndarray:
    """(R, C) heights with slopes of all sizes, of sums alone: the same bits everywhere."""
    z = np.zeros((rows, columns))
    for size in (1, 2, 4, 8, 16):
        coarse = rng.integers(-1000, 1001, (rows // size + 3, columns // size + 3)) / 1000.0
        down, across = np.arange(rows)[:, None], np.arange(columns)[None]
        i, j, x, y = down // size, across // size, across % size / size, down % size / size
        upper = coarse[i, j] * (1 - x) + coarse[i, j + 1] * x
        z += size * 0.4 * (upper * (1 - y) + (coarse[i + 1, j] * (1 - x) + coarse[i + 1, j + 1] * x) * y)
    return rough * z


def depth_surface(rng: np.random.Generator, rows: int, columns: int) -> np.ndarray:
    """(R, C, 3) positions of a depth image, with steps in its depth."""
    down, across = np.mgrid[:rows, :columns]
    depth = 3.0 + 0.1 * terrain(rng, rows, columns)
    depth[:, columns // 3 :] += 1.5
    depth[rows // 2 :, : columns // 2] -= 1.0
    depth = np.maximum(depth, 0.25)
    x, y = (across - columns / 2 + 0.5) / columns, (down - rows / 2 + 0.5) / columns
    return np.stack([x * depth, y * depth, depth], axis=-1)


def sun(elevation: float, azimuth: float) -> DirectionalLight:
    """The sun at so many degrees, the azimuth clockwise from +y."""
    up, around = np.radians(elevation), np.radians(azimuth)
    towards = np.array([np.sin(around) * np.cos(up), np.cos(around) * np.cos(up), np.sin(up)])
    towards[np.abs(towards) < 1e-12] = 0.0
    return DirectionalLight(f"sun {elevation:g} {azimuth:g}", -towards)


def turned(angle: float, axis: tuple[float, float, float], place: tuple[float, float, float]) -> np.ndarray:
    """A pose: a turn around an axis, then a shift."""
    x, y, z = np.array(axis) / np.linalg.norm(axis)
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    pose = np.eye(4)
    pose[:3, :3] += np.sin(angle) * cross + (1 - np.cos(angle)) * cross @ cross
    pose[:3, 3] = place
    return pose


def moved(pose: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Points (N, 3), or one, by a pose."""
    return points @ pose[:3, :3].T + pose[:3, 3]


def around(rng: np.random.Generator, positions: np.ndarray, number: int) -> np.ndarray:
    """Points on a surface, near to it, and anywhere."""
    flat = positions[~np.isnan(positions[..., 2])]
    low, high = flat.min(axis=0), flat.max(axis=0)
    some = flat[rng.integers(0, len(flat), number)]
    span = (high - low).max()
    near = some + 0.01 * span * rng.uniform(-1, 1, (number, 3))
    return np.concatenate([some, near, rng.uniform(low - 0.3 * span, high + 0.3 * span, (number, 3))])


def lights_around(center: np.ndarray, size: float) -> list[Any]:
    """Lights of all kinds about something of that size, steep and grazing ones, near and far."""
    ways = [(-1, 0.3, -0.2), (0, 0, -1), (0, 0, 1), (1, 0, -0.01), (1, 1, 0.01), (0, -1, 0), (0.3, 1, -1)]
    lights: list[Any] = [DirectionalLight(f"sun {k}", way) for k, way in enumerate(ways)]
    places = [(0, 0, 1), (0.2, 0.1, -1), (2, -1, 0), (0, 0, 0), (1e4, 0, 1e4)]
    lights += [PointLight(f"lamp {k}", center + size * np.array(place)) for k, place in enumerate(places)]
    lights.append(SpotLight("spot", center + (0, 0, size), (0.1, 0.2, -1.0), 0.5))
    return lights


def tracer(device: str, pipeline: str, **more: Any) -> ShadowTracer:
    """A fresh one."""
    threads = more.pop("threads", 1)
    return ShadowTracer(pipeline, device=device, bounds=Bounds(**{**BOUNDS, **more}), threads=threads)


def agree(
    device: str,
    setup: Setup,
    points: np.ndarray,
    lights: Sequence[Any],
    bias: float = 0.0,
    cull: bool = False,
    ours: ShadowTracer | None = None,
    pipeline: str = "height_field",
    **more: Any,
) -> tuple[np.ndarray, dict[str, int], ShadowTracer]:
    """States of points and lights that a pipeline and brute_force agree on, the pipeline's counters, and its tracer."""
    found = []
    for tracing in (ours or tracer(device, pipeline, **more), tracer(device, "brute_force")):
        setup(tracing.scene)
        tracing.front_face_culling = cull
        traced = probe.trace_points(tracing, points, lights, bias)
        found.append((np.array(traced.states), traced.counters, tracing))
    (states, counters, tracing), (expected, theirs, _) = found
    wrong = np.argwhere(states != expected)
    assert not len(wrong), [
        (lights[light].name, points[point], int(expected[light, point])) for light, point in wrong[:3]
    ]
    for name in ("rays", "triangles", "degenerate", "culled"):
        assert counters[name] == theirs[name], name
    return states, counters, tracing
