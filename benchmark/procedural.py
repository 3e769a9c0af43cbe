# SPDX-License-Identifier: Apache-2.0
"""Three scenes made by code, for benchmarks and tests: robots in a street, a museum full of small triangles, and a
teapot in a stadium.

``robots`` is what the papers call so: few very large and very thin triangles (ground, walls, poles, wires) and clusters
of small ones. ``museum`` is as incoherent as can be: independent small triangles in a closed room, so that neighbouring
pixels see things far apart. ``stadium`` has nearly all its triangles, of 5 mm, in one place of a bowl of 300 m: what
breaks grids of equal cells. All move, all take a wished number of triangles, all are the same on every machine (numpy
and a fixed seed). Metres, z is up.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from shadow_tracer import Camera, DirectionalLight, PointLight, SpotLight

Light = PointLight | SpotLight | DirectionalLight
Part = tuple[np.ndarray, np.ndarray]


@dataclass(frozen=True)
class Eye:
    """Where a view is taken from.

    Attributes:
        position: (3,) metres.
        target: (3,) what the middle of the image looks at.
        width: width of the image plane at distance 1 (2 tan of half the opening angle).
        disc: only pixels within the circle that fits the image count; the rest are to be invalid.
    """

    position: tuple[float, float, float]
    target: tuple[float, float, float]
    width: float
    disc: bool = False

    def camera(self, size: int) -> Camera:
        """A camera of ``size`` x ``size`` pixels. With a power of two, every 2^k-th pixel of an image is exactly an
        image of the camera 2^k times smaller whose principal point and focal length are divided by 2^k."""
        up = (0.0, 1.0, 0.0) if self.position[:2] == self.target[:2] else (0.0, 0.0, 1.0)
        middle = 0.5 * size - 0.5
        pose = look_at(self.position, self.target, up)
        return Camera(size, size, size / self.width, size / self.width, middle, middle, pose)

    def pixels(self, size: int) -> np.ndarray:
        """(size, size) bool: the pixels that count."""
        if not self.disc:
            return np.ones((size, size), bool)
        rows, columns = np.mgrid[0:size, 0:size] - (0.5 * size - 0.5)
        inside: np.ndarray = np.hypot(rows, columns) < 0.5 * size
        return inside


@dataclass(frozen=True)
class Procedural:
    """A scene.

    Attributes:
        name: what it is called.
        positions: (F, V, 3) float64 vertices per frame.
        triangles: (T, 3) int32.
        eyes: views by name.
        lights: lights by name.
    """

    name: str
    positions: np.ndarray
    triangles: np.ndarray
    eyes: dict[str, Eye]
    lights: dict[str, Light]


def look_at(eye: Iterable[float], target: Iterable[float], up: Iterable[float]) -> np.ndarray:
    """(4, 4) camera_to_world of an optical frame (x right, y down, z forward)."""
    eye, target = np.asarray(list(eye), np.float64), np.asarray(list(target), np.float64)
    forward = (target - eye) / np.linalg.norm(target - eye)
    right = np.cross(forward, np.asarray(list(up), np.float64))
    right /= np.linalg.norm(right)
    pose = np.eye(4)
    pose[:3, 0], pose[:3, 1], pose[:3, 2], pose[:3, 3] = right, np.cross(forward, right), forward, eye
    return pose


def _box(low: Iterable[float], high: Iterable[float]) -> Part:
    ends = np.array([list(low), list(high)], np.float64)
    corners = np.array([[ends[k >> axis & 1, axis] for axis in range(3)] for k in range(8)])
    sides = [(0, 4, 6, 2), (1, 3, 7, 5), (0, 1, 5, 4), (2, 6, 7, 3), (0, 2, 3, 1), (4, 5, 7, 6)]
    return corners, np.array([t for a, b, c, d in sides for t in ((a, b, c), (a, c, d))], np.int32)


def _ellipsoid(rings: int, radii: Iterable[float]) -> Part:
    """A closed latitude/longitude ellipsoid about the origin: 4 rings (rings - 1) triangles."""
    around = 2 * rings
    theta, phi = np.pi * np.arange(1, rings) / rings, 2.0 * np.pi * np.arange(around) / around
    ring = np.stack([np.cos(phi), np.sin(phi)], axis=1)
    grid = [np.column_stack([np.sin(t) * ring, np.full(around, np.cos(t))]) for t in theta]
    vertices = np.concatenate([*grid, [[0.0, 0.0, 1.0], [0.0, 0.0, -1.0]]]) * list(radii)
    j, k = np.arange(around), (np.arange(around) + 1) % around
    top, bottom, last = len(vertices) - 2, len(vertices) - 1, (rings - 2) * around
    parts = [np.stack([np.full(around, top), j, k], 1), np.stack([np.full(around, bottom), last + k, last + j], 1)]
    for i in range(rings - 2):
        a, b, c, d = i * around + j, i * around + k, (i + 1) * around + k, (i + 1) * around + j
        parts += [np.stack([a, d, c], 1), np.stack([a, c, b], 1)]
    return vertices, np.concatenate(parts).astype(np.int32)


def _joined(parts: Iterable[Part]) -> Part:
    vertices, triangles, count = [], [], 0
    for part_vertices, part_triangles in parts:
        vertices.append(part_vertices)
        triangles.append(part_triangles + count)
        count += len(part_vertices)
    return np.concatenate(vertices), np.concatenate(triangles).astype(np.int32)


# --- robots ---

# offset, radii and swing of each part of a body [m]: trunk, head, two arms, two legs
_BODY = (
    ((0.0, 0.0, 1.15), (0.22, 0.30, 0.42), 0.0),
    ((0.0, 0.0, 1.75), (0.14, 0.13, 0.18), 0.0),
    ((0.0, 0.42, 1.15), (0.09, 0.09, 0.40), 0.25),
    ((0.0, -0.42, 1.15), (0.09, 0.09, 0.40), -0.25),
    ((0.0, 0.15, 0.42), (0.11, 0.10, 0.42), -0.30),
    ((0.0, -0.15, 0.42), (0.11, 0.10, 0.42), 0.30),
)
_BODIES = 26


def _street(rng: np.random.Generator) -> Part:
    """Ground and house fronts of a few very large triangles, ledges, poles and wires of very thin ones."""
    parts = [_box((-120.0, -30.0, -0.5), (120.0, 30.0, 0.0))]
    for side in (-1.0, 1.0):
        for k in range(8):
            x, front, height = -96.0 + 24.0 * k, 7.0 + rng.uniform(0.0, 1.5), rng.uniform(9.0, 22.0)
            y = sorted((side * front, side * (front + 12.0)))
            parts.append(_box((x, y[0], 0.0), (x + 22.0, y[1], height)))
            for floor in np.arange(3.0, height - 1.0, 3.0):
                y = sorted((side * (front - 0.15), side * (front - 0.01)))
                parts.append(_box((x, y[0], floor), (x + 22.0, y[1], floor + 0.05)))
            parts.append(_box((x + 23.0, side * 5.5 - 0.04, 0.0), (x + 23.08, side * 5.5 + 0.04, 6.0)))
    for k in range(12):
        x = -90.0 + 16.0 * k
        parts.append(_box((x, -7.0, 6.0 + 0.1 * k), (x + 0.02, 7.0, 6.02 + 0.1 * k)))
    return _joined(parts)


@lru_cache(maxsize=4)
def robots(triangles: int = 70_000, frames: int = 2) -> Procedural:
    """About ``triangles`` triangles: a street canyon with 26 bodies that walk, 0.05 s per frame."""
    rng = np.random.default_rng(1)
    street = _street(rng)
    rings = 3
    while len(street[1]) + len(_BODY) * _BODIES * 4 * (rings + 1) * rings <= 1.05 * triangles:
        rings += 1
    at = np.column_stack([rng.uniform(-34.0, 40.0, _BODIES), rng.uniform(-4.5, 4.5, _BODIES), np.zeros(_BODIES)])
    phase = rng.uniform(0.0, 2.0 * np.pi, _BODIES)
    positions = []
    for frame in range(frames):
        parts = [street]
        for where, start in zip(at, phase, strict=True):
            for offset, radii, swing in _BODY:
                vertices, faces = _ellipsoid(rings, radii)
                step = swing * np.sin(start + 0.3 * frame)
                shift = where + offset + [0.07 * frame + step, 0.0, 0.02 * np.sin(2.0 * (start + 0.3 * frame))]
                parts.append((vertices + shift, faces))
        joined, faces = _joined(parts)
        positions.append(joined)
    eyes = {
        "corridor": Eye((-40.0, 0.5, 2.2), (40.0, -0.5, 1.0), 1.1),
        "grazing": Eye((-36.0, -2.0, 0.25), (40.0, 1.0, 0.2), 1.1),
        "wall": Eye((6.0, 5.9, 1.4), (6.2, 9.0, 1.5), 1.1),
        "disc": Eye((-10.0, 0.3, 12.0), (4.0, 0.0, 0.0), 2.4, disc=True),
    }
    lights: dict[str, Light] = {
        "inside": PointLight("inside", (3.0, 0.4, 5.2)),
        "outside": PointLight("outside", (-60.0, 8.0, 60.0)),
        "grazing": PointLight("grazing", (60.0, 1.3, 0.35)),
        "far": PointLight("far", (-4.0e3, 1.5e3, 9.0e3)),
        "sun": DirectionalLight("sun", (0.42, -0.16, -0.89)),
        "spot": SpotLight("spot", (-38.0, 2.5, 1.9), (1.0, -0.05, -0.1), 0.5, range=75.0),
    }
    return Procedural("robots", np.stack(positions), faces, eyes, lights)


# --- museum ---

_HALF = np.array([10.0, 8.0, 3.0])
_MARGIN = 0.9  # along the walls nothing floats: the wall view sees the wall


@lru_cache(maxsize=4)
def museum(triangles: int = 75_012, frames: int = 2) -> Procedural:
    """A closed room of 20 x 16 x 6 m (12 triangles) with ``triangles`` - 12 independent ones that drift and turn.

    Their size goes with the inverse square root of their number, so that about as much of the room is visible from a
    point whatever the number.
    """
    rng = np.random.default_rng(2)
    count = triangles - 12
    room = _box(-_HALF, _HALF)
    size = 0.12 * np.sqrt(75_000 / count)
    centres = rng.uniform(-1.0, 1.0, (count, 1, 3)) * (_HALF - _MARGIN)
    shapes = rng.normal(size=(count, 3, 3)) * size * 0.5
    shapes -= shapes.mean(axis=1, keepdims=True)
    drift = rng.normal(size=(count, 1, 3)) * 0.02
    turns = rng.normal(size=count) * 0.1
    positions = []
    for frame in range(frames):
        c, s = np.cos(turns * frame)[:, None], np.sin(turns * frame)[:, None]
        x, y, z = (shapes[:, :, k] for k in range(3))
        turned = np.stack([c * x - s * y, s * x + c * y, z], axis=2)
        positions.append(np.concatenate([room[0], (centres + drift * frame + turned).reshape(-1, 3)]))
    faces = np.concatenate([room[1], 8 + np.arange(3 * count, dtype=np.int32).reshape(-1, 3)])
    eyes = {
        "room": Eye((-9.4, -7.4, 1.5), (6.0, 4.0, -0.5), 1.1),
        "centre": Eye((0.0, 0.0, 0.1), (5.0, 1.0, 0.0), 2.0),
        "wallview": Eye((9.4, 1.0, 0.2), (10.0, 1.0, 0.2), 1.1),
    }
    lights: dict[str, Light] = {
        "inside": PointLight("inside", (1.0, -0.6, 1.9)),
        "corner": PointLight("corner", (9.8, 7.8, 2.8)),
        "grazing": PointLight("grazing", (-2.0, 1.0, -2.97)),
        "far": PointLight("far", (5.0e3, 3.0e3, 8.0e3)),
        "sun": DirectionalLight("sun", (-0.3, 0.5, -0.8)),
        "spot": SpotLight("spot", (-3.0, -7.5, 2.5), (0.5, 1.0, -0.4), 0.6),
    }
    return Procedural("museum", np.stack(positions), faces, eyes, lights)


# --- stadium ---

_EDGE = 0.005
_POT = np.array([4.0, -3.0, 0.0])  # where the pot stands on the pitch


def _torus(around: int, along: int, radius: float, thickness: float) -> Part:
    """A closed ring in the plane y = 0: 2 around along triangles."""
    phi, theta = 2.0 * np.pi * np.arange(along) / along, 2.0 * np.pi * np.arange(around) / around
    out = radius + thickness * np.cos(theta)
    x, z = np.outer(np.cos(phi), out), np.outer(np.sin(phi), out)
    y = np.broadcast_to(thickness * np.sin(theta), x.shape)
    i, j = (k.reshape(-1) for k in np.mgrid[0:along, 0:around])
    i_next, j_next = (i + 1) % along, (j + 1) % around
    a, b, c, d = i * around + j, i_next * around + j, i_next * around + j_next, i * around + j_next
    triangles = np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)])
    return np.stack([x, y, z], axis=-1).reshape(-1, 3), triangles.astype(np.int32)


def _teapot(triangles: int) -> tuple[Part, float]:
    """At most ``triangles`` triangles with edges of about ``_EDGE``, standing on the origin: body, knob, handle and
    spout, each closed. The more triangles, the larger the pot; its radius comes with it."""
    rings = max(4, int(np.sqrt(triangles / 6.05)))
    radius = rings * _EDGE / np.pi * 1.1
    small = max(3, rings // 3)
    body, knob = _ellipsoid(rings, np.array([1.0, 1.0, 0.8]) * radius), _ellipsoid(small, [0.2 * radius] * 3)
    handle, spout = _torus(small, 2 * rings, 0.5 * radius, 0.1 * radius), _ellipsoid(small, [0.1 * radius] * 3)
    slanted = spout[0] * [1.0, 1.0, 6.0]
    slanted[:, 0] += 1.1 * slanted[:, 2]
    middle = 0.8 * radius
    parts = [
        (body[0] + [0.0, 0.0, middle], body[1]),
        (knob[0] + [0.0, 0.0, middle + 0.9 * radius], knob[1]),
        (handle[0] + [-1.0 * radius, 0.0, middle], handle[1]),
        (slanted + [0.9 * radius, 0.0, middle + 0.1 * radius], spout[1]),
    ]
    return _joined(parts), radius


def _bowl(around: int, rows: int) -> Part:
    """Terraces from 60 m to 150 m about the origin, a ring of roof over the last of them, and the pitch: two
    triangles."""
    tread, rise = 90.0 / rows, 40.0 / rows
    profile = [(60.0, 0.0)]
    for row in range(rows):
        profile += [(60.0 + tread * row, rise * (row + 1)), (60.0 + tread * (row + 1), rise * (row + 1))]
    phi = 2.0 * np.pi * np.arange(around) / around
    ring = np.stack([np.cos(phi), np.sin(phi)], axis=1)
    parts = [_box((-155.0, -155.0, -1.0), (155.0, 155.0, 0.0))]
    j, k = np.arange(around), (np.arange(around) + 1) % around
    for run in (profile, [(105.0, 52.0), (152.0, 58.0)]):
        vertices = np.concatenate([np.column_stack([r * ring, np.full(around, z)]) for r, z in run])
        triangles = [np.stack([i * around + j, i * around + k, (i + 1) * around + k], 1) for i in range(len(run) - 1)]
        triangles += [
            np.stack([i * around + j, (i + 1) * around + k, (i + 1) * around + j], 1) for i in range(len(run) - 1)
        ]
        parts.append((vertices, np.concatenate(triangles).astype(np.int32)))
    for x, y in ((-1.0, -1.0), (-1.0, 1.0), (1.0, -1.0), (1.0, 1.0)):
        parts.append(_box((x * 108.0 - 0.4, y * 108.0 - 0.4, 0.0), (x * 108.0 + 0.4, y * 108.0 + 0.4, 95.0)))
    return _joined(parts)


@lru_cache(maxsize=4)
def stadium(triangles: int = 70_000, frames: int = 2) -> Procedural:
    """About ``triangles`` triangles, nine of ten of them 5 mm wide: a teapot that turns, 3 degrees per frame, on the
    pitch of a stadium 300 m wide.

    ``far``, ``star`` and ``sun`` are the same light, 50 km, 1e8 m and infinitely far away.
    """
    rows = max(2, int(np.sqrt(triangles / 10.0 / 8.0)))
    bowl = _bowl(2 * rows, rows)
    pot, radius = _teapot(triangles - len(bowl[1]))
    positions = []
    for frame in range(frames):
        angle = np.radians(20.0 + 3.0 * frame)
        turn = np.array([[np.cos(angle), -np.sin(angle), 0.0], [np.sin(angle), np.cos(angle), 0.0], [0.0, 0.0, 1.0]])
        joined, faces = _joined([bowl, (pot[0] @ turn.T + _POT + [0.0, 0.0, 1e-3], pot[1])])
        positions.append(joined)

    def near(x: float, y: float, z: float) -> tuple[float, float, float]:
        """Radii of the pot from where it stands."""
        place = _POT + radius * np.array([x, y, z])
        return float(place[0]), float(place[1]), float(place[2])

    eyes = {
        "pot": Eye(near(-2.5, -5.0, 3.0), near(0.0, 0.0, 0.8), 0.5),
        "touchline": Eye(near(5.0, 4.0, 1.5), near(-3.0, -4.0, 1.4), 1.6),
        "stand": Eye((-140.0, 20.0, 46.0), (60.0, -10.0, 0.0), 1.6),
    }
    sun = np.array([0.48, -0.6, -0.64])  # a unit vector
    middle = np.array(near(0.0, 0.0, 0.8))
    lights: dict[str, Light] = {
        "inside": PointLight("inside", tuple(middle + [0.48, -0.6, 0.64])),  # one metre from the pot
        "outside": PointLight("outside", tuple(middle + [96.0, 72.0, 160.0])),  # two hundred
        "far": PointLight("far", tuple(middle - 5e4 * sun)),
        "star": PointLight("star", tuple(middle - 1e8 * sun)),
        "sun": DirectionalLight("sun", tuple(sun)),
        "spot": SpotLight("spot", (-108.0, 108.0, 97.0), tuple(middle - [-108.0, 108.0, 97.0]), 0.12),
    }
    return Procedural("stadium", np.stack(positions), faces, eyes, lights)


SCENES: dict[str, Callable[..., Procedural]] = {"robots": robots, "museum": museum, "stadium": stadium}


def wavy_sheet(cells: int, phase: float) -> tuple[np.ndarray, np.ndarray]:
    """A sheet of 2 * cells^2 triangles between camera and wall that waves with ``phase``."""
    u, v = np.meshgrid(np.linspace(-0.6, 0.6, cells + 1), np.linspace(-0.45, 0.45, cells + 1))
    z = 1.2 + 0.08 * np.sin(7 * u + phase) * np.cos(5 * v - phase)
    corner = np.arange(cells)[:, None] * (cells + 1) + np.arange(cells)
    a, b, c, d = corner, corner + 1, corner + cells + 2, corner + cells + 1
    triangles = np.stack([a, b, c, a, c, d], axis=-1).reshape(-1, 3)
    return np.stack([u, v, z], axis=-1).reshape(-1, 3), triangles
