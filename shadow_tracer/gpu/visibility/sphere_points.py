# SPDX-License-Identifier: Apache-2.0
"""Sphere lights as many points: traced as point lights, in batches of as many lights as a frame has room for, or asked
about all together, and counted.

What is traced is exact, so the counts are the same whatever the pipeline, however the lights are cut into batches, and
whether their points are lights or bits.
"""

from __future__ import annotations

import math
import operator
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from shadow_tracer.gpu.device.counters import LARGEST
from shadow_tracer.gpu.exact.light_frame import INVALID, LIT, OUTSIDE, SHADOWED
from shadow_tracer.scene.lights import HardLight, Light, PointLight, SphereLight

PENUMBRA = 4  # shadow_tracer.visibility.State; on the device 4 means something else

_ONES = np.array([bin(byte).count("1") for byte in range(256)], np.uint8)

States = npt.NDArray[np.uint8]
Counts = npt.NDArray[np.uint16]


def is_soft(lights: Sequence[Light]) -> bool:
    """Whether there is a sphere light among them."""
    return any(isinstance(light, SphereLight) for light in lights)


@dataclass(frozen=True)
class _Part:
    """A light to be traced, for light number ``light``: it ``tells`` where that light shines (and, of a hard light, all
    there is to know), it ``counts`` as one of its points, or both."""

    light: int
    hard: HardLight
    tells: bool
    counts: bool


class Tally:
    """States of lights, spheres among them, gathered from those of the point lights that stand for them.

    Args:
        lights: all lights of the frame.
        count: samples of the frame.
        together: the most point lights of a batch.
        masks: whether of spheres the centres alone are traced, and their points are counted by ``count``.
    """

    def __init__(self, lights: Sequence[Light], count: int, together: int, masks: bool = False) -> None:
        self._lights = lights
        self._together = together
        self._masks = masks
        self._parts = [part for number, light in enumerate(lights) for part in _parts(number, light, masks)]
        # Hard lights first: then they are in the same batch, frame after frame, however many spheres there are.
        self._parts.sort(key=lambda part: isinstance(lights[part.light], SphereLight))
        self._states: States = np.full((len(lights), count), LIT, np.uint8)
        self._reached: dict[int, Counts] = {
            number: np.zeros(count, np.uint16) for number, light in enumerate(lights) if isinstance(light, SphereLight)
        }

    def batches(self) -> Iterator[tuple[int, list[HardLight]]]:
        """Number of the first point light, and the lights, of each batch."""
        for first in range(0, len(self._parts), self._together):
            yield first, [part.hard for part in self._parts[first : first + self._together]]

    def add(self, first: int, states: States) -> None:
        """Take in the (B, N) states of the batch that begins with point light number ``first``."""
        for part, row in zip(self._parts[first : first + len(states)], states, strict=True):
            if part.tells:
                self._states[part.light] = row
            if part.counts:
                self._reached[part.light] += row == LIT

    def spheres(self, first: int, batch: int) -> Iterator[tuple[int, int, SphereLight]]:
        """With ``masks``, of the spheres whose centres are in a batch: place in it, number, and light."""
        for place, part in enumerate(self._parts[first : first + batch]):
            light = self._lights[part.light]
            if self._masks and isinstance(light, SphereLight):
                yield place, part.light, light

    def count(self, number: int, first: int, seen: npt.NDArray[np.uint64]) -> None:
        """Take in which points of light ``number`` the samples from ``first`` on see, as bits."""
        ones = _ONES[seen.view(np.uint8).reshape(len(seen), 8)].sum(axis=1, dtype=np.uint16)
        self._reached[number][first : first + len(seen)] += ones

    def result(self) -> tuple[States, dict[int, Counts]]:
        """(L, N) states of the lights, and (N,) for each sphere how many of its points reach: 0 where it does not
        shine."""
        for number, reached in self._reached.items():
            light, states = self._lights[number], self._states[number]
            assert isinstance(light, SphereLight)
            shines = (states != OUTSIDE) & (states != INVALID)
            reached *= shines
            found = np.full(len(states), PENUMBRA, np.uint8)
            found[reached == 0] = SHADOWED
            found[reached == light.samples] = LIT
            np.copyto(states, found, where=shines)
        return self._states, self._reached


def _parts(number: int, light: Light, masks: bool) -> Iterator[_Part]:
    if not isinstance(light, SphereLight):
        yield _Part(number, light, True, False)
        return
    bounded = math.isfinite(light.range)
    if bounded or masks:
        yield _Part(number, PointLight(light.name, light.position, light.range), True, False)
    if masks:
        return
    # What the centre does not reach is not asked about; so points need not reach farther than this, roundings included.
    reach = (light.range + light.radius) * (1.0 + 1e-9) + 1e-9 * float(np.abs(light.position).max())
    for index, point in enumerate(light.points):
        yield _Part(number, PointLight(light.name, point, reach), index == 0 and not bounded, True)


def add_up(total: dict[str, int], batch: dict[str, int]) -> dict[str, int]:
    """Counters of all batches so far and those of a further one together: what is of the scene, or of the last light,
    is the latter's."""
    ways: dict[str, Callable[[int, int], int]] = dict.fromkeys(("triangles", "degenerate", "culled"), _later)
    ways |= dict.fromkeys(LARGEST, max)
    return {name: ways.get(name, operator.add)(total.get(name, 0), value) for name, value in batch.items()}


def _later(_: int, later: int) -> int:
    return later
