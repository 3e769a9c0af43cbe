# SPDX-License-Identifier: Apache-2.0
"""What of a lamp's ball reaches the floor, with guarantees, a radio link past a mast, and where to put a camera.

    python benchmark/pictures_cones.py

draws ``docs/images/cones.png``. Left: each pixel of the floor asks about the cone from there to the ball: white where
all of it certainly reaches (lit), black where nothing does (umbra), grey where neither is certain (penumbra). Middle:
from a mast at the left, the first Fresnel zone of 24 GHz to each place 60 cm above the floor, in two cones that meet in
the middle: white where both are free, red where the straight line is but not the zone, dark where not even the line is.
Right: of three parts how many a camera 1.4 m above the floor certainly sees as a whole, from none (dark) to all
(white).
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import numpy.typing as npt
from PIL import Image, ImageDraw

from shadow_tracer import Bounds, Outcome, PointLight, ShadowTracer

_OUT = Path(__file__).resolve().parents[1] / "docs" / "images" / "cones.png"
_SIZE = 360
_LAMP, _RADIUS = np.array([0.3, 0.2, 3.0]), 0.25
_MAST, _WAVELENGTH = np.array([-3.7, 0.0, 0.6]), 0.0125
_COLOURS = {Outcome.FREE: (250, 247, 235), Outcome.PARTLY: (150, 150, 165), Outcome.BLOCKED: (25, 25, 40)}
_PARTS, _SIZE_OF_PART, _UP = [(-0.3, -0.7, 0.3), (-2.9, 0.3, 0.3), (2.7, 0.5, 0.3)], 0.25, 1.4
_SEEN = ((45, 50, 70), (115, 120, 150), (180, 185, 200), (250, 247, 235))
_FREE, _NARROW, _HIDDEN = (250, 247, 235), (205, 85, 65), (45, 50, 70)


def _box(low: tuple[float, float, float], high: tuple[float, float, float]) -> tuple[np.ndarray, np.ndarray]:
    corners = np.array([[(low, high)[k >> axis & 1][axis] for axis in range(3)] for k in range(8)])
    quads = [(0, 2, 3, 1), (4, 5, 7, 6), (0, 1, 5, 4), (2, 6, 7, 3), (0, 4, 6, 2), (1, 3, 7, 5)]
    return corners, np.array([part for a, b, c, d in quads for part in ((a, b, c), (a, c, d))])


def _ball(centre: tuple[float, float, float], radius: float, steps: int = 24) -> tuple[np.ndarray, np.ndarray]:
    """Closed: the corners of its poles lie at one place."""
    turn, rise = np.arange(2 * steps) * np.pi / steps, np.arange(steps + 1) * np.pi / steps
    ring = np.stack([np.cos(turn), np.sin(turn)], axis=1)
    width = np.sin(rise)
    width[[0, -1]] = 0.0
    points = np.concatenate(
        [np.column_stack([w * ring, np.full(len(ring), c)]) for w, c in zip(width, np.cos(rise), strict=True)]
    )
    row, column = np.mgrid[:steps, : 2 * steps].reshape(2, -1)
    beside = (column + 1) % (2 * steps)
    a, b, c, d = (r * 2 * steps + k for r, k in ((row, column), (row + 1, column), (row + 1, beside), (row, beside)))
    return radius * points + centre, np.concatenate([np.stack([a, b, c], axis=1), np.stack([a, c, d], axis=1)])


def _tracer() -> ShadowTracer:
    tracer = ShadowTracer(device="cpu", bounds=Bounds(max_triangles=20_000, max_rays=_SIZE * _SIZE))
    for number, (x, y) in enumerate([(-1.5, -1.2), (-1.4, 1.6), (1.8, -1.5)]):
        tracer.scene.put(f"crate {number}", *_box((x, y, 0.05), (x + 0.7, y + 0.6, 0.9)))
    tracer.scene.put("ball", *_ball((0.9, 1.2, 1.0), 0.55))
    tracer.scene.put("bar", *_box((-2.5, -0.05, 1.2), (2.5, 0.05, 1.3)))
    tracer.scene.put("wire", *_box((-2.5, -2.405, 0.7), (2.5, -2.395, 0.71)))
    return tracer


def _floor() -> npt.NDArray[np.float64]:
    steps = (np.arange(_SIZE) + 0.5) / _SIZE * 8.0 - 4.0
    x, y = np.meshgrid(steps, steps[::-1])
    return np.stack([x, y, np.zeros_like(x)], axis=-1)


def _lamp(tracer: ShadowTracer) -> npt.NDArray[np.uint8]:
    floor, picture = _floor(), np.zeros((_SIZE, _SIZE, 3), np.uint8)
    far = np.linalg.norm(_LAMP - floor, axis=-1)
    # The disc through its middle that hides the ball, as seen from there.
    outcomes = tracer.cones(floor, _LAMP, half_angle=np.arcsin(_RADIUS / far))
    for outcome, colour in _COLOURS.items():
        picture[outcomes == outcome] = colour
    return picture


def _link(tracer: ShadowTracer) -> npt.NDArray[np.uint8]:
    places = _floor() + [0.0, 0.0, 0.6]
    far = np.linalg.norm(places - _MAST, axis=-1)
    # At x from an end the zone's radius is sqrt(l x (D - x) / D), which is less than sqrt(l x), and that is at most
    # sqrt(l) (x + s) / (2 sqrt(s)): a cone whose apex is any s behind the end.
    behind, middle = far / 8.0, 0.5 * (places + _MAST)
    free = np.ones(far.shape, bool)
    for end in (places, np.broadcast_to(_MAST, places.shape)):
        apex = end + (end - middle) / 4.0
        radius = np.sqrt(_WAVELENGTH) * (far / 2.0 + behind) / (2.0 * np.sqrt(behind))
        free &= tracer.cones(apex, middle, radius) == Outcome.FREE
    line = tracer.cones(places, _MAST, 0.0) == Outcome.FREE
    picture = np.where(free[..., None], _FREE, np.where(line[..., None], _NARROW, _HIDDEN))
    return picture.astype(np.uint8)


def _camera(tracer: ShadowTracer) -> npt.NDArray[np.uint8]:
    places, seen = _floor() + [0.0, 0.0, _UP], np.zeros((_SIZE, _SIZE), int)
    for number, place in enumerate(_PARTS):
        tracer.scene.put(f"part {number}", *_ball(place, _SIZE_OF_PART))
    for number, place in enumerate(_PARTS):
        part = PointLight("middle", place, ignore=[f"part {number}"])  # it does not hide itself
        far = np.linalg.norm(places - place, axis=-1)
        seen += tracer.cones(places, part, half_angle=np.arcsin(_SIZE_OF_PART / far)) == Outcome.FREE
    picture = np.array(_SEEN, np.uint8)[seen]
    for x, y, _ in _PARTS:
        row, column = round((4.0 - y) / 8.0 * _SIZE), round((x + 4.0) / 8.0 * _SIZE)
        picture[row - 3 : row + 4, column - 3 : column + 4] = (205, 85, 65)
    return picture


def main() -> None:
    tracer = _tracer()
    image = Image.new("RGB", (3 * _SIZE + 24, _SIZE + 22), (255, 255, 255))
    draw = ImageDraw.Draw(image)
    for number, (text, pixels) in enumerate(
        [
            ("lamp of 25 cm: lit, not certain, umbra", _lamp(tracer)),
            ("link from the left: free, line only, hidden", _link(tracer)),
            ("camera: sees all, two, one, none of the parts", _camera(tracer)),
        ]
    ):
        image.paste(Image.fromarray(pixels), (number * (_SIZE + 12), 22))
        draw.text((number * (_SIZE + 12) + 4, 5), text, fill=(0, 0, 0))
    image.quantize(32).save(_OUT, optimize=True)
    print(_OUT)


if __name__ == "__main__":
    main()
