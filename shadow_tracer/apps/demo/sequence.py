# SPDX-License-Identifier: Apache-2.0
"""What a demo plays: a sequence of views, each a depth image with camera, colours and mesh."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from shadow_tracer.apps.demo import render, workshop
from shadow_tracer.apps.demo.lighting import StageLight
from shadow_tracer.scene.camera import Camera
from shadow_tracer.scene.lights import DirectionalLight, PointLight, SpotLight

STILL_PHASE = 0.12
STILL_SCALE = 2
STILL_PIXELS = 1_310_720


@dataclass(frozen=True)
class View:
    """One frame of a sequence.

    Attributes:
        camera: pinhole camera with its pose in the world.
        depth: (H, W) float32 metres (NaN invalid) or uint16 millimetres (0 invalid).
        colour: (H, W, 3) uint8 sRGB.
        vertices: (V, 3) float64 metres; None if the mesh is that of the view before.
    """

    camera: Camera
    depth: NDArray[Any]
    colour: NDArray[np.uint8]
    vertices: NDArray[np.float64] | None


class Sequence(Protocol):
    """A numbered set of views with the lights they are lit by.

    Attributes:
        title: what is played, in a word.
        lights: the lights, with colours.
        triangles: (T, 3) int32, the same in all views.
        down: unit vector to the ground.
        smooth: how far [px] to average normals, 0 for noise-free depth.
        bias: constant [m] and quadratic [1/m] bias that suits the data.
        frame_time: seconds per view in an animation.
        animated: the first so many views make the animation.
        still: the view that makes the single pictures.
    """

    title: str
    lights: tuple[StageLight, ...]
    triangles: NDArray[np.int32]
    down: tuple[float, float, float]
    smooth: int
    bias: tuple[float, float]
    frame_time: float
    animated: int
    still: int

    def __len__(self) -> int: ...

    def view(self, index: int) -> View:
        """View `index`, the same whenever it is asked for."""
        ...


class WorkshopSequence:
    """The workshop in one endless round of `frames` views, then one view of higher resolution for the pictures.

    Args:
        frames: views in the round, at least 1.
        size: (width, height) pixels.

    Raises:
        ValueError: if a number is out of range.
    """

    def __init__(self, frames: int, size: tuple[int, int]) -> None:
        if frames < 1:
            raise ValueError(f"frames: must be 1 or more, got {frames}")
        width, height = size
        if not (16 <= width and 16 <= height and width * height <= STILL_PIXELS):
            raise ValueError(
                f"size: must be at least 16x16 and at most {STILL_PIXELS} pixels in all, got {width}x{height}"
            )
        self._scene = workshop.Workshop()
        self._size = size
        self.title = "workshop"
        self.lights = workshop_lights()
        self.triangles = self._scene.triangles
        self.down = (0.0, 0.0, -1.0)
        self.smooth = 0
        self.bias = (0.01, 0.0)
        self.frame_time = 0.08
        self.animated = self.still = frames

    def __len__(self) -> int:
        return self.animated + 1

    def view(self, index: int) -> View:
        """View `index`; the last one is the still."""
        if not 0 <= index < len(self):
            raise ValueError(f"index: must be 0..{len(self) - 1}, got {index}")
        width, height = self._size
        phase = index / self.animated
        if index == self.still:
            phase = STILL_PHASE
            if width * height * STILL_SCALE**2 <= STILL_PIXELS:
                width, height = width * STILL_SCALE, height * STILL_SCALE
        focal = 0.72 * width
        camera = Camera(width, height, focal, focal, (width - 1) / 2, (height - 1) / 2, workshop.camera_to_world(phase))
        vertices = self._scene.vertices(phase)
        depth, ids = render.RayCaster(vertices, self.triangles).image(camera)
        colour = render.paint(depth, ids, self._scene.colours, self._scene.still_triangles, camera)
        return View(camera, depth, colour, vertices)


def workshop_lights() -> tuple[StageLight, ...]:
    """A warm pendant lamp, a cool spotlight on the robot and the sun through windows and skylights."""
    aim = np.subtract(workshop.SPOT_AIM, workshop.SPOT_AT)
    return (
        StageLight(PointLight("lamp", np.array(workshop.LAMP_AT)), (1.0, 0.66, 0.33), 7.0),
        StageLight(SpotLight("spotlight", np.array(workshop.SPOT_AT), aim, 0.42), (0.42, 0.72, 1.0), 36.0),
        StageLight(DirectionalLight("sun", np.array(workshop.SUN_WAY)), (1.0, 0.90, 0.74), 2.2),
    )


def open_sequence(data: Path | None, mesh: Path | None, frames: int | None, size: tuple[int, int]) -> Sequence:
    """The workshop, or the recording in the folder `data`.

    Args:
        frames: how many views; None for 40 of the workshop or all of a recording.
        size: (width, height) of the workshop's camera; a recording has its own.
    """
    if data is None:
        return WorkshopSequence(40 if frames is None else frames, size)
    from shadow_tracer.apps.demo.recorded import FolderSequence

    return FolderSequence(data, mesh, frames)
