# SPDX-License-Identifier: Apache-2.0
"""Revisions of the scene on the device, and which triangles another one has elsewhere: so what is made of the scene is
made again for the parts that have changed, and for no others."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

from shadow_tracer.gpu.occluders.slots import Ranges, few, merged

# After more revisions than this everything is made again.
_KEPT = 64


@dataclass(frozen=True)
class Revision:
    """What is on the device. What is made of the scene is kept with the revision that it was made for.

    Attributes:
        topology: another number whenever triangles may have others' places or corners.
        positions: another number whenever anything is different.
    """

    topology: int = 0
    positions: int = 0


@dataclass(frozen=True)
class Changed:
    """What has to be made again of the scene.

    Attributes:
        triangles: their ranges; those where there are none any more may lie behind the last one.
        vertices: those of these triangles.
        everything: whether that is all there is.
    """

    triangles: Ranges = ()
    vertices: Ranges = ()
    everything: bool = False

    def __bool__(self) -> bool:
        return self.everything or bool(self.triangles)


class History:
    """What has changed in each of the last revisions, each numbered one more than the one before."""

    def __init__(self) -> None:
        self._steps: deque[tuple[int, Ranges, Ranges]] = deque(maxlen=_KEPT)
        self._asked: tuple[int, Changed] | None = None  # last, and what was said

    def add(self, number: int, triangles: Ranges, vertices: Ranges) -> None:
        """Revision ``number`` has other triangles, and vertices, in these ranges."""
        self._asked = None
        self._steps.append((number, triangles, vertices))

    def clear(self) -> None:
        """Nothing is known of earlier revisions."""
        self._asked = None
        self._steps.clear()

    def since(self, number: int) -> Changed | None:
        """What has changed since revision ``number``; None if that is not known."""
        if not self._steps or self._steps[0][0] > number + 1:
            return None
        if self._asked is None or self._asked[0] != number:
            steps = [step for step in self._steps if step[0] > number]
            triangles = merged(each for step in steps for each in step[1])
            vertices = merged(each for step in steps for each in step[2])
            self._asked = number, Changed(few(triangles), few(vertices))
        return self._asked[1]
