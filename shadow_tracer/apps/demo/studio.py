# SPDX-License-Identifier: Apache-2.0
"""Makes pictures of shots while the next ones are still being traced."""

from __future__ import annotations

import threading
from collections.abc import Sequence as Many
from pathlib import Path
from queue import Queue
from typing import Any

from PIL import Image

from shadow_tracer.apps.demo import pictures
from shadow_tracer.apps.demo.collector import Shot
from shadow_tracer.apps.demo.sequence import Sequence
from shadow_tracer.apps.demo.shading import Surface

PANEL_HEIGHT = 360


class Studio:
    """Shades shots for the animation, in a thread.

    Args:
        sequence: what is played; gives the lights, the way down and how smooth the depth is.
        height: of the frames of the animation, in pixels.

    Attributes:
        done: how many shots have been shaded.
    """

    def __init__(self, sequence: Sequence, height: int = PANEL_HEIGHT) -> None:
        self._sequence = sequence
        self._height = height
        self._shots: Queue[tuple[int, Shot] | None] = Queue()
        self._panels: dict[int, Image.Image] = {}
        self._error: Exception | None = None
        self.done = 0
        self._added = 0
        self._thread = threading.Thread(target=self._run, name="studio", daemon=True)
        self._thread.start()

    def add(self, index: int, shot: Shot) -> None:
        """Queues a shot for the animation."""
        self._added += 1
        self._shots.put((index, shot))

    @property
    def working(self) -> bool:
        """Whether shots are still to be shaded."""
        return self.done < self._added and self._thread.is_alive()

    def finish(self) -> dict[int, Image.Image]:
        """Waits for the last shot; all animation frames by index, in order. Raises what went wrong."""
        self._shots.put(None)
        self._thread.join()
        if self._error is not None:
            raise self._error
        return dict(sorted(self._panels.items()))

    def _run(self) -> None:
        try:
            while (item := self._shots.get()) is not None:
                index, shot = item
                overlay = surface_of(shot, self._sequence).lit(self._sequence.lights, shot.masks)
                self._panels[index] = pictures.panel(overlay, shot.masks, self._sequence.lights, self._height)
                self.done += 1
        except Exception as error:  # raised again where the result is asked for
            self._error = error


def surface_of(shot: Shot, sequence: Sequence) -> Surface:
    """What the camera saw, ready to be lit."""
    return Surface(shot.depth, shot.colour, shot.camera, sequence.down, sequence.smooth)


def save_portrait(shot: Shot, sequence: Sequence, folder: Path, facts: Many[str]) -> list[Path]:
    """Saves the contact sheet of one shot and its single pictures; returns their paths.

    Args:
        facts: short texts for the line below the title.
    """
    lights = sequence.lights
    surface = surface_of(shot, sequence)
    whole = surface.lit(lights, shot.masks)
    single = {light.name: surface.lit([light], shot.masks, ambient=0.8) for light in lights}
    title = f"shadow_tracer: {sequence.title}"
    sheet = pictures.contact_sheet(title, "   ·   ".join(facts), whole, shot.depth, shot.masks, single, lights)
    images: dict[str, Any] = {
        "contact_sheet": sheet,
        "all_lights": Image.fromarray(whole),
        "depth": Image.fromarray(pictures.depth_picture(shot.depth)),
    }
    for light in lights:
        images[f"{light.name}_mask"] = Image.fromarray(shot.masks[light.name])
        images[f"{light.name}_shaded"] = Image.fromarray(single[light.name])
    paths = []
    for name, image in images.items():
        paths.append(folder / f"{name}.png")
        image.save(paths[-1])
    return paths
