# SPDX-License-Identifier: Apache-2.0
"""The demo scene: a workshop in which a robot swings, a forklift drives, boxes ride and a curtain waves.

World frame: x east, y north, z up (ENU), metres. Everything repeats after `phase` 1.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from shadow_tracer.apps.demo import furniture, robot
from shadow_tracer.apps.demo.parts import (
    Colour,
    Floats,
    Part,
    box,
    cylinder,
    grid,
    join,
    lathe,
    make,
    pierced_wall,
    rotation,
    translation,
    tube,
)

LENGTH, WIDTH, HEIGHT = 14.0, 9.0, 5.0
ROBOT_AT = (7.7, 5.0, 0.12)
CONVEYOR_AT, CONVEYOR_LENGTH, CARTON_STEP = (5.2, 6.95, 0.0), 6.6, 1.1
LAMP_AT = (9.6, 6.1, 3.05)
SPOT_AT, SPOT_AIM = (4.6, 2.4, 4.3), (8.6, 5.2, 0.8)
SUN_WAY = (-0.30, 0.60, -0.74)

CONCRETE: Colour = (0.60, 0.59, 0.57)
PLASTER: Colour = (0.86, 0.85, 0.81)
WAINSCOT: Colour = (0.33, 0.43, 0.49)
GIRDER: Colour = (0.42, 0.47, 0.50)
FRAME: Colour = (0.25, 0.27, 0.29)
SHEET: Colour = (0.74, 0.76, 0.77)
CURTAIN: Colour = (0.74, 0.25, 0.17)

Motion = Callable[[float], Floats]


class Workshop:
    """The scene as one mesh whose vertices depend on the phase.

    Attributes:
        triangles: (T, 3) int32, the same at all times.
        colours: (T, 3) float32 albedo, sRGB 0..1.
        still_triangles: the first so many triangles never move.
    """

    def __init__(self) -> None:
        still = _hall()
        bodies = [*_robot(), *_forklift(), *_cartons()]
        curtain = _curtain(0.0)
        whole = join([still, *(part for part, _ in bodies), curtain])
        self.triangles: NDArray[np.int32] = whole.triangles
        self.colours: NDArray[np.float32] = whole.colours
        self.still_triangles = len(still.triangles)
        self._vertices = whole.vertices
        self._bodies: list[tuple[slice, Floats, Motion]] = []
        start = len(still.vertices)
        for part, motion in bodies:
            self._bodies.append((slice(start, start + len(part.vertices)), part.vertices, motion))
            start += len(part.vertices)
        self._curtain = slice(start, start + len(curtain.vertices))

    def vertices(self, phase: float) -> Floats:
        """(V, 3) float64 positions [m] at `phase` (one round is 0..1)."""
        out = self._vertices.copy()
        for where, local, motion in self._bodies:
            pose = motion(phase)
            out[where] = local @ pose[:3, :3].T + pose[:3, 3]
        out[self._curtain] = _curtain(phase).vertices
        return out


def camera_to_world(phase: float) -> Floats:
    """(4, 4) pose of the optical frame (x right, y down, z forward) on its small round."""
    a = 2 * np.pi * phase
    eye = np.array([1.75 + 0.25 * np.cos(a), 3.35 + 0.55 * np.sin(a), 2.55 + 0.15 * np.sin(a + 0.8)])
    return look_at(eye, np.array([8.0, 4.45 + 0.15 * np.sin(a), 1.05]), np.array([0.0, 0.0, 1.0]))


def look_at(eye: Floats, target: Floats, up: Floats) -> Floats:
    """(4, 4) camera-to-world pose of an optical frame at `eye` that looks at `target`."""
    forward = (target - eye) / np.linalg.norm(target - eye)
    right = np.cross(forward, up)
    right /= np.linalg.norm(right)
    pose = np.eye(4)
    pose[:3, :4] = np.column_stack([right, np.cross(forward, right), forward, eye])
    return pose


def _hall() -> Part:
    """All that stands still."""
    rng = np.random.default_rng(7)
    rack = furniture.rack(4, rng).at(4.3, WIDTH - 0.15, 0)
    at = ROBOT_AT
    parts = [_floor(rng), _markings(), *_walls(), _roof(), *_girders(), *_fixtures(), rack]
    parts.append(cylinder(0.75, 0.12, FRAME, 56, bevel=0.02).at(at[0], at[1], 0))
    parts.append(furniture.conveyor(CONVEYOR_LENGTH).at(*CONVEYOR_AT))
    parts.append(furniture.fence(np.array([[7.9, 3.45], [9.2, 3.45], [10.5, 3.45], [10.5, 4.7], [10.5, 5.95]])))
    parts.append(furniture.bench().moved(translation(4.75, 5.9, 0) @ rotation("z", 1.1)))
    parts.append(furniture.pallet().moved(translation(9.35, 4.35, 0) @ rotation("z", 0.25)))
    for k, (x, y) in enumerate([(-0.3, -0.15), (0.1, 0.15), (0.35, -0.2)]):
        parts.append(furniture.crate((0.36, 0.30, 0.26), furniture.CRATES[k]).at(9.35 + x, 4.35 + y, 0.14))
    for k, (x, y) in enumerate([(4.2, 0.75), (4.85, 0.62), (4.55, 1.25)]):
        parts.append(furniture.drum(furniture.DRUMS[k]).at(x, y, 0))
    parts.append(furniture.pipe_stack(2.6, 3, 0.13, (0.58, 0.60, 0.62)).at(11.6, 0.65, 0))
    parts += [furniture.tyre(0.42, 0.12).at(13.0, 2.4, 0.22 * k) for k in range(5)]
    parts.append(furniture.pallet().at(12.6, 7.3, 0))
    parts += [
        furniture.carton((0.5, 0.6, 0.42), furniture.CARDBOARD[k % 4]).at(
            12.35 + 0.53 * (k % 2), 7.3, 0.14 + 0.43 * (k // 2)
        )
        for k in range(5)
    ]
    return join(parts)


def _floor(rng: np.random.Generator) -> Part:
    """Concrete tiles of slightly different grey."""
    across, along = int(LENGTH * 2), int(WIDTH * 2)
    x, y = np.meshgrid(np.linspace(0, LENGTH, across + 1), np.linspace(0, WIDTH, along + 1), indexing="ij")
    part = make(np.stack([x, y, np.zeros_like(x)], axis=-1), grid(across + 1, along + 1), CONCRETE)
    slab = rng.uniform(0.94, 1.04, (across // 4 + 1, along // 4 + 1))
    shade = np.kron(slab, np.ones((4, 4)))[:across, :along] * rng.uniform(0.985, 1.015, (across, along))
    return Part(part.vertices, part.triangles, part.colours * np.repeat(shade, 2).astype(np.float32)[:, None])


def _markings() -> Part:
    """Painted lines and slab joints: sheets 2 mm thick, thinner than any bias."""
    paint: list[tuple[float, float, float, float, Colour]] = [
        (0.3, 13.6, 2.98, 3.08, robot.HAZARD),
        (0.3, 13.6, 0.30, 0.38, robot.HAZARD),
        (5.6, 7.7, 3.55, 3.62, robot.HAZARD),
        (5.6, 5.67, 3.55, 6.3, robot.HAZARD),
    ]
    paint += [(x, x + 0.012, 0.0, WIDTH, (0.36, 0.35, 0.34)) for x in np.arange(2.0, LENGTH, 2.0).tolist()]
    paint += [(0.0, LENGTH, y, y + 0.012, (0.36, 0.35, 0.34)) for y in np.arange(2.0, WIDTH, 2.0).tolist()]
    return join(
        box((x1 - x0, y1 - y0, 0.002), c, centre=((x0 + x1) / 2, (y0 + y1) / 2, 0.001)) for x0, x1, y0, y1, c in paint
    )


def _walls() -> list[Part]:
    """Four walls that overlap at the corners; the south one (y = 0) has windows with glazing bars."""
    bands = [(1.15, WAINSCOT), (HEIGHT, PLASTER)]
    starts: list[float] = np.arange(1.0, LENGTH - 1.5, 2.5).tolist()
    windows = [(x + 0.2, x + 2.0, 1.25, 3.7) for x in starts]
    south = pierced_wall(LENGTH + 0.4, HEIGHT, 0.2, windows, bands).at(-0.2, 0, 0)
    parts = [south]
    for x in starts:
        parts += [box((0.05, 0.09, 2.45), FRAME, centre=(x + s, -0.1, 2.475)) for s in (0.03, 0.6, 1.2, 1.77)]
        parts += [box((1.8, 0.09, 0.05), FRAME, centre=(x + 0.9, -0.1, z)) for z in (1.28, 2.06, 2.88, 3.67)]
        parts.append(box((2.0, 0.34, 0.06), PLASTER, 0.01, (x + 0.9, 0.02, 1.22)))
    north = pierced_wall(LENGTH + 0.4, HEIGHT, 0.2, [], bands).at(-0.2, WIDTH + 0.2, 0)
    turn = rotation("z", np.pi / 2)
    side = pierced_wall(WIDTH + 0.4, HEIGHT, 0.2, [], bands).moved(turn).at(0, -0.2, 0)
    west, east = side.at(-0.2, 0, 0), side.at(LENGTH, 0, 0)
    gate = [box((0.05, 2.9, 0.24), SHEET, 0.02, (LENGTH - 0.05, 4.9, 0.14 + 0.26 * k)) for k in range(12)]
    posts = [box((0.12, 0.16, 3.4), robot.HAZARD, 0.02, (LENGTH - 0.08, y, 1.7)) for y in (3.35, 6.45)]
    return [*parts, north, west, east, *gate, *posts]


def _roof() -> Part:
    """A flat roof with skylights, the sheet 0.15 m thick."""
    lights = [(x, x + 2.3, 0.75, 2.35) for x in (3.4, 6.4, 9.4)] + [(x, x + 2.3, 3.6, 4.8) for x in (6.4, 9.4)]
    shifted = [(x0 + 0.2, x1 + 0.2, y0 + 0.2, y1 + 0.2) for x0, x1, y0, y1 in lights]
    sheet = pierced_wall(LENGTH + 0.4, WIDTH + 0.4, 0.15, shifted, [(WIDTH + 0.4, SHEET)]).at(-0.2, 0, -0.2)
    flat = np.array([[1, 0, 0, 0], [0, 0, 1, 0], [0, -1, 0, HEIGHT], [0, 0, 0, 1.0]])
    bars = [
        box((0.05, y1 - y0, 0.06), FRAME, centre=(x0 + s, (y0 + y1) / 2, HEIGHT + 0.05))
        for x0, _, y0, y1 in lights
        for s in (0.575, 1.15, 1.725)
    ]
    return join([sheet.moved(flat), *bars])


def _girders() -> list[Part]:
    """Steel I-beams under the roof, a duct and cable trays."""
    parts: list[Part] = []
    for x in (2.6, 6.05, 9.05, 12.05):
        parts += [box((0.22, WIDTH, 0.03), GIRDER, centre=(x, WIDTH / 2, z)) for z in (4.62, 4.95)]
        parts.append(box((0.03, WIDTH, 0.33), GIRDER, centre=(x, WIDTH / 2, 4.79)))
        parts += [box((0.18, 0.18, 4.65), GIRDER, 0.02, (x, y, 2.32)) for y in (0.1, WIDTH - 0.1)]
    duct = [
        (-0.1, 7.3, 4.25),
        (11.2, 7.3, 4.25),
        (11.6, 7.22, 4.25),
        (11.82, 6.9, 4.25),
        (11.9, 6.5, 4.25),
        (11.9, 2.0, 4.25),
    ]
    parts.append(tube(duct, 0.24, SHEET, 32))
    parts += [tube([(x, 7.3 - 0.27, 4.25), (x, 7.3, 4.53), (x, 7.3, 4.95)], 0.012, FRAME, 6) for x in (3.0, 6.0, 9.0)]
    rings = lathe([(0.235, 0), (0.27, 0), (0.27, 0.05), (0.235, 0.05)], GIRDER, 32, closed=True).moved(
        rotation("y", np.pi / 2)
    )
    parts += [rings.at(x, 7.3, 4.25) for x in np.arange(1.5, 11.0, 1.5).tolist()]
    return parts


def _fixtures() -> list[Part]:
    """The pendant lamp's shade and the spotlight's housing, around their lights but not in their way."""
    x, y, z = LAMP_AT
    shade = [
        (0.045, 0.30),
        (0.07, 0.24),
        (0.30, -0.02),
        (0.36, -0.10),
        (0.35, -0.10),
        (0.285, -0.01),
        (0.055, 0.235),
        (0.03, 0.30),
    ]
    lamp = [lathe(shade, (0.10, 0.30, 0.26), 40, closed=True).at(x, y, z)]
    lamp.append(tube([(x, y, z + 0.24), (x, y, HEIGHT)], 0.012, FRAME, 8))
    hood = [(0.0, -0.34), (0.12, -0.34), (0.17, -0.26), (0.19, 0.10), (0.18, 0.10), (0.16, -0.24), (0.0, -0.24)]
    aim = look_at(np.array(SPOT_AT), np.array(SPOT_AIM), np.array([0.0, 0.0, 1.0]))
    spot = [lathe(hood, FRAME, 36).moved(aim)]
    spot.append(tube([(SPOT_AT[0], SPOT_AT[1], SPOT_AT[2] + 0.2), (SPOT_AT[0], SPOT_AT[1], HEIGHT)], 0.02, FRAME, 8))
    return lamp + spot


def _robot() -> list[tuple[Part, Motion]]:
    base = translation(*ROBOT_AT) @ rotation("z", np.pi)

    def motion(link: int) -> Motion:
        return lambda phase: robot.forward_kinematics(base, robot.gesture(phase))[link]

    return [(part, motion(i)) for i, part in enumerate(robot.links())]


def _forklift() -> list[tuple[Part, Motion]]:
    """Drives west to the camera and backs off again, raising its fork meanwhile."""
    body, wheel, fork = furniture.forklift()

    def drive(phase: float) -> Floats:
        a = 2 * np.pi * phase
        return translation(9.9 + 1.8 * np.cos(a), 1.85 + 0.05 * np.sin(a), 0.0) @ rotation(
            "z", np.pi + 0.05 * np.sin(a)
        )

    def rolling(x: float, y: float) -> Motion:
        return lambda phase: (
            drive(phase) @ translation(x, y, 0.30) @ rotation("y", -1.8 * np.cos(2 * np.pi * phase) / 0.30)
        )

    def lifting(phase: float) -> Floats:
        return drive(phase) @ translation(0, 0, 0.45 - 0.40 * np.cos(2 * np.pi * phase))

    wheels: Sequence[tuple[float, float]] = ((0.62, 0.52), (0.62, -0.52), (-0.78, 0.50), (-0.78, -0.50))
    return [(body, drive), (fork, lifting), *((wheel, rolling(x, y)) for x, y in wheels)]


def _cartons() -> list[tuple[Part, Motion]]:
    """Cartons on the conveyor; each takes the place of the next in one round, out of sight in the tunnels."""
    x0, y, _ = CONVEYOR_AT
    sizes = [(0.46, 0.40, 0.34), (0.40, 0.46, 0.26), (0.52, 0.38, 0.42)]

    def ride(k: int) -> Motion:
        return lambda phase: translation(x0 + 0.1 + (k + phase) * CARTON_STEP, y, 0.80) @ rotation("z", 0.12)

    # all alike, or the jump back to the start of the round would show
    return [
        (furniture.carton(sizes[0], furniture.CARDBOARD[2]), ride(k)) for k in range(int(CONVEYOR_LENGTH / CARTON_STEP))
    ]


def _curtain(phase: float) -> Part:
    """A welding curtain behind the robot cell that waves in the draught."""
    rows, columns = 26, 56
    v, u = np.meshgrid(np.linspace(0, 1, rows), np.linspace(0, 1, columns), indexing="ij")
    a = 2 * np.pi * phase
    swing = 0.05 + 0.95 * v
    x = 11.55 + 0.07 * np.sin(40 * u) + swing * (0.14 * np.sin(9 * u - 2 * a) + 0.34 * v * np.sin(4 * u - a + 1.5 * v))
    y = 3.5 + 2.75 * u + 0.02 * np.cos(80 * u)
    z = 3.05 - 2.75 * v + 0.05 * v * np.sin(7 * u - a)
    return make(np.stack([x, y, z], axis=-1), grid(rows, columns), CURTAIN)
