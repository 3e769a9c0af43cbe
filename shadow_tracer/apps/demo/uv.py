# SPDX-License-Identifier: Apache-2.0
"""`shadow_tracer demo --uv`: a robot with a UV-C tube drives through a hospital room, and the dose of its surfaces
grows."""

from __future__ import annotations

import argparse
import math
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw

from shadow_tracer import Bounds, Camera, DoseMap, Scene, ShadowTracer, Strength, TubeLight, render_depth
from shadow_tracer.apps.demo import hospital, pictures
from shadow_tracer.apps.demo.parts import Floats, Part
from shadow_tracer.apps.demo.recorded import load_mesh
from shadow_tracer.apps.demo.route import TALL, drive
from shadow_tracer.dose_picture import overview
from shadow_tracer.scene.dose_colors import NEVER, REACHED, colors_of, viridis

TARGET = 280.0  # J/m2: 28 mJ/cm2
WATTS = 60.0
FRAMES = 60
_SLOW = 1.7  # times as long as if all light went where it is still wanted
_LARGE = 400.0  # m2: a room is cut finely and exposed from many places, a building is not
_POINTS = 16  # of the tube: each stands for a piece of it in closed form
_FINER = 2  # drawn so many times larger
_BAR = 26  # height of the legend [px]


class Stage:
    """The place, the robot in it, and what the place has received.

    Args:
        mesh: file with a mesh of a place, z up; None: a room made by code.
        device, pipeline, variant: as for :class:`ShadowTracer`.

    Raises:
        ValueError: no such mesh, or no room to drive in it.
    """

    def __init__(self, mesh: Path | None, device: str | None, pipeline: str, variant: str) -> None:
        made = hospital.room()
        vertices, triangles = (made.vertices, made.triangles) if mesh is None else _loaded(mesh)
        self.title = "hospital room" if mesh is None else mesh.stem
        body, glass = hospital.robot()
        corners = vertices[triangles]
        area = 0.5 * float(
            np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1).sum()
        )
        edge, apart, self._step = (0.14, 1.3, 0.5) if area < _LARGE else (0.9, 4.0, 2.5)
        texels = 20 * len(triangles) + round(8.0 * area / edge**2)
        bounds = Bounds(max_triangles=len(triangles) + 4096, max_rays=max(1024, min(texels, 1 << 17)))
        self.tracer = ShadowTracer(pipeline, variant or None, device, bounds)
        self.scene = self.tracer.scene
        self.scene.put("room", vertices, triangles)
        for name, part, casts in (("robot", body, True), ("tube", glass, False)):
            self.scene.put(name, part.vertices, part.triangles, cast_shadows=casts)
        self.dose = DoseMap(self.tracer, "room", edge)
        self.way = drive(self.dose.corners.mean(axis=1), self.dose.normals, hospital.RADIUS + 0.05, apart)
        self.seconds = _SLOW * TARGET * area / WATTS

    def stand(self, place: Floats) -> TubeLight:
        """Put the robot on a place (3,) of the floor; the lamp there."""
        pose = np.eye(4)
        pose[:3, 3] = place
        for name in ("robot", "tube"):
            self.scene.move(name, pose)
        low, high, radius = hospital.LAMP
        ends = place + (0.0, 0.0, low), place + (0.0, 0.0, high)
        return TubeLight("uv", *ends, radius, samples=_POINTS, strength=Strength(power=WATTS))

    def steps(self, frames: int) -> Iterator[list[tuple[Floats, float]]]:
        """Of each frame the places (3,), evenly along the way, and how long each is exposed from [s]."""
        length = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(self.way, axis=0), axis=1))])
        several = max(1, math.ceil(length[-1] / frames / self._step))
        for frame in range(frames):
            at = (frame + (np.arange(several) + 0.5) / several) / frames * length[-1]
            places = np.column_stack([np.interp(at, length, self.way[:, axis]) for axis in range(3)])
            yield [(place, self.seconds / frames / several) for place in places]


def _loaded(mesh: Path) -> tuple[Floats, NDArray[np.int32]]:
    if not mesh.is_file():
        raise ValueError(f"data: expected a file with a mesh, got {mesh}")
    return load_mesh(mesh)


class Painter:
    """Draws a stage from above: texels that face the camera, what of them is not above head height of a building, and
    the robot."""

    def __init__(self, stage: Stage, height: int, device: str | None) -> None:
        self._stage, self._device = stage, device
        corners = stage.dose.corners
        floor = float(stage.way[0, 2])
        self._size = round(1.5 * height), height
        size = _FINER * self._size[0], _FINER * self._size[1]
        self.camera: Camera = overview(corners.reshape(-1, 3), size)
        towards = ((self.camera.position - corners[:, 0]) * stage.dose.normals).sum(axis=1) > 0.0
        self._seen = np.flatnonzero(towards & (corners[:, :, 2].max(axis=1) <= floor + max(TALL, hospital.HIGH) + 0.01))
        sun = np.array([0.35, -0.45, 0.82])
        self._shade = 0.74 + 0.26 * (stage.dose.normals[self._seen] @ sun)
        self._scene = Scene(Bounds(max_triangles=len(self._seen) + 4096))
        count = len(self._seen)
        self._scene.put("texels", corners[self._seen].reshape(-1, 3), np.arange(3 * count).reshape(-1, 3))
        colours = []
        for name, part in zip(("robot", "tube"), hospital.robot(), strict=True):
            self._scene.put(name, part.vertices, part.triangles)
            colours.append(255.0 * part.colours * (1.0 if name == "tube" else _shades(part, sun)))
        self._others = np.concatenate([*colours, np.array([pictures.BACKGROUND])]).astype(np.uint8)

    def draw(self, place: Floats) -> Image.Image:
        """As it is now, with the robot on a place."""
        stage = self._stage
        pose = np.eye(4)
        pose[:3, 3] = place
        for name in ("robot", "tube"):
            self._scene.move(name, pose)
        _, triangle = render_depth(self._scene, self.camera, self._device)
        colours = colors_of(stage.dose.dose[self._seen], TARGET) * self._shade[:, None]
        palette = np.concatenate([np.clip(colours, 0, 255).astype(np.uint8), self._others])
        width, height = self._size
        canvas = Image.new("RGB", (width, height + _BAR), pictures.BACKGROUND)
        canvas.paste(Image.fromarray(palette[triangle]).resize(self._size, Image.Resampling.BOX), (0, 0))
        self._legend(ImageDraw.Draw(canvas), width, height)
        return canvas

    def _legend(self, draw: ImageDraw.ImageDraw, width: int, top: int) -> None:
        dose = self._stage.dose
        minutes, seconds = divmod(round(dose.seconds), 60)
        clock = f"{minutes // 60} h {minutes % 60:02d} min" if minutes >= 100 else f"{minutes} min {seconds:02d} s"
        said = f"{clock}   {100.0 * dose.coverage(TARGET):.0f} % has {TARGET:g} J/m2"
        draw.text((10, top + 6), said, font=pictures.font(14), fill=pictures.INK)
        right, bar = width - 10, 120
        for x, colour, text in ((right - 46, NEVER, "never"), (right - 96, REACHED, f"{TARGET:g}")):
            draw.rectangle((x - 14, top + 8, x - 4, top + 18), fill=colour)
            draw.text((x, top + 6), text, font=pictures.font(12), fill=pictures.FAINT)
        left = right - 96 - 26 - bar
        for k, colour in enumerate(viridis(np.linspace(0.0, 1.0, bar)).tolist()):
            draw.line((left + k, top + 8, left + k, top + 18), fill=tuple(colour))
        draw.text((left - 12, top + 6), "0", font=pictures.font(12), fill=pictures.FAINT)


def _shades(part: Part, sun: Floats) -> Floats:
    """(T, 1) how bright triangles are."""
    a, b, c = (part.vertices[part.triangles[:, k]] for k in range(3))
    normals = np.cross(b - a, c - a)
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12)
    shades: Floats = 0.75 + 0.25 * (normals @ sun)[:, None]
    return shades


def perform(chosen: argparse.Namespace, say: Callable[[str], Any]) -> Path:
    """Drive, and save the animation; its path.

    Raises:
        ValueError: an option or the mesh is wrong.
    """
    frames = FRAMES if chosen.frames is None else chosen.frames
    if frames < 2:
        raise ValueError(f"frames: must be 2 or more, got {frames}")
    start, device = time.monotonic(), None if chosen.device == "auto" else chosen.device
    stage = Stage(chosen.data, device, chosen.pipeline, chosen.variant)
    chosen.output.mkdir(parents=True, exist_ok=True)
    painter = Painter(stage, chosen.animation_height, device)
    triangles, area, minutes = len(stage.scene["room"].triangles), stage.dose.area.sum(), stage.seconds / 60.0
    say(
        f"{stage.title}: {triangles:,} triangles, {len(stage.dose):,} texels of {area:.0f} m2, a tube of {WATTS:g} W "
        f"UV-C, {minutes:.0f} min on the way"
    )
    images = [painter.draw(stage.way[0])]
    place = stage.way[0]
    for step in stage.steps(frames):
        for place, seconds in step:
            stage.dose.add([stage.stand(place)], seconds)
        images.append(painter.draw(place))
    path = Path(chosen.output) / "uv.gif"
    pictures.save_animation(images, path, [0.6, *([0.1] * (frames - 1)), 2.5])
    covered, never = 100.0 * stage.dose.coverage(TARGET), stage.dose.area[stage.dose.never_reached].sum()
    say(
        f"{covered:.1f} % of the surface has {TARGET:g} J/m2, {never:.1f} m2 were never reached; "
        f"{time.monotonic() - start:.0f} s here"
    )
    return path
