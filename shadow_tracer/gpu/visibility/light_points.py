# SPDX-License-Identifier: Apache-2.0
"""Lights with size as many points: traced as lights without, in batches of as many as a frame has room for, or asked
about all together.

What is traced is exact, so the bits are the same whatever the pipeline, however the lights are cut into batches, and
whether their points are lights or bits.
"""

from __future__ import annotations

import operator
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from shadow_tracer.gpu.device.counters import LARGEST
from shadow_tracer.gpu.exact.light_frame import INVALID, LIT, OUTSIDE, SHADOWED
from shadow_tracer.gpu.visibility.light_bits import Bits, Counts, Reaching, ones_of
from shadow_tracer.scene.area_lights import MOST_BITS
from shadow_tracer.scene.lights import AreaLight, HardLight, Light

PENUMBRA = 4  # shadow_tracer.visibility.State; on the device 4 means something else

States = npt.NDArray[np.uint8]
Names = tuple[str, ...]


def is_soft(lights: Sequence[Light]) -> bool:
    """Whether there is a light with size among them."""
    return any(isinstance(light, AreaLight) for light in lights)


def ignored_by(light: Light) -> Names:
    """Names of the meshes that cast no shadow in a light."""
    return tuple(light.ignore)


@dataclass(frozen=True)
class _Part:
    """A light to be traced, for light number ``light``: it ``tells`` where that light shines (and, of a hard light, all
    there is to know), it is one of its points (-1: it is none), or both."""

    light: int
    hard: HardLight
    tells: bool
    point: int


@dataclass(frozen=True)
class Batch:
    """Lights that are traced together: number of the first part, the lights, meshes that cast nothing in any, whether
    it is asked what is hidden from them (else only where they shine), and whether they are points that could have been
    asked about together."""

    first: int
    lights: list[HardLight]
    ignored: Names
    hidden: bool
    apart: bool


class _Points:
    """Which points of a light reach, as they come in."""

    def __init__(self, light: AreaLight, count: int) -> None:
        self.samples = light.samples
        # A byte of the bits each, for all samples: the bits one by one are set eight times as fast there.
        self._octets = np.zeros((8, count), np.uint8) if light.samples <= MOST_BITS else None
        self._bits: Bits | None = None  # of all points together, if they have come so
        self._counts: Counts = np.zeros(count if self._octets is None else 0, np.uint16)

    def add(self, point: int, lit: npt.NDArray[np.bool_]) -> None:
        """Take in where one point reaches."""
        if self._octets is None:
            self._counts += lit
        else:
            self._octets[point >> 3] |= lit.view(np.uint8) << np.uint8(point & 7)

    def put(self, begin: int, first: int, seen: npt.NDArray[np.uint64]) -> None:
        """Take in the bits of the points from ``begin`` on, of samples from ``first`` on."""
        some = slice(first, first + len(seen))
        if self._octets is None:
            self._counts[some] += ones_of(seen)
            return
        if self._bits is None:
            self._bits = np.zeros(self._octets.shape[1], np.uint64)
        self._bits[some] = seen

    def reaching(self, where: npt.NDArray[np.bool_]) -> Reaching:
        """All together; none reaches but ``where``."""
        if self._octets is None:
            return Reaching(self.samples, None, self._counts * where)
        bits = self._bits
        if bits is None:
            bits = np.ascontiguousarray(self._octets.T).view("<u8").reshape(-1).astype(np.uint64, copy=False)
        bits *= where
        return Reaching(self.samples, bits, ones_of(bits))


class Tally:
    """States of lights, some with size, gathered from those of the hard lights that stand for them.

    Args:
        lights: all lights of the frame.
        count: samples of the frame.
        together: the most hard lights of a batch.
        masks: whether of lights with size it is only traced where they shine, and their points come by ``put``.
    """

    def __init__(self, lights: Sequence[Light], count: int, together: int, masks: bool = False) -> None:
        self._lights = lights
        self._together = together
        self._masks = masks
        self._parts = [part for number, light in enumerate(lights) for part in _parts(number, light, masks)]
        # Those in which the same meshes cast nothing, and of these hard lights first: then they are in the same batch,
        # frame after frame, however many points there are.
        self._parts.sort(key=lambda part: (ignored_by(lights[part.light]), isinstance(lights[part.light], AreaLight)))
        self._states: States = np.full((len(lights), count), LIT, np.uint8)
        self._points = {
            number: _Points(light, count) for number, light in enumerate(lights) if isinstance(light, AreaLight)
        }

    def batches(self) -> Iterator[Batch]:
        """All parts."""
        first = 0
        while first < len(self._parts):
            kind = self._kind(first)
            end = first
            while end < min(len(self._parts), first + self._together) and self._kind(end) == kind:
                end += 1
            yield Batch(first, [part.hard for part in self._parts[first:end]], *kind)
            first = end

    def _kind(self, number: int) -> tuple[Names, bool, bool]:
        part = self._parts[number]
        light = self._lights[part.light]
        masked = self._masks and isinstance(light, AreaLight)
        return ignored_by(light), not masked or part.point >= 0, masked and part.point >= 0

    def add(self, batch: Batch, states: States) -> None:
        """Take in the (B, N) states of a batch."""
        for part, row in zip(self._parts[batch.first : batch.first + len(states)], states, strict=True):
            if part.tells:
                self._states[part.light] = row
            if part.point >= 0:
                self._points[part.light].add(part.point, row == LIT)

    def area_lights(self, batch: Batch) -> Iterator[tuple[int, int, AreaLight]]:
        """With ``masks``, of the lights with size that a batch tells of: place in it, number, and light."""
        for place, part in enumerate(self._parts[batch.first : batch.first + len(batch.lights)]):
            light = self._lights[part.light]
            if part.tells and self._masks and isinstance(light, AreaLight):
                yield place, part.light, light

    def divide(self, number: int) -> None:
        """Let the points of light ``number``, of which it has been told where it shines, be traced one by one after
        all."""
        light = self._lights[number]
        assert isinstance(light, AreaLight)
        self._parts += [_Part(number, point, False, index) for index, point in enumerate(light.hard_lights())]

    def put(self, number: int, begin: int, first: int, seen: npt.NDArray[np.uint64]) -> None:
        """Take in which points of light ``number``, from ``begin`` on, the samples from ``first`` on see, as bits."""
        self._points[number].put(begin, first, seen)

    def result(self) -> tuple[States, dict[int, Reaching]]:
        """(L, N) states of the lights, and for each light with size which of its points reach (N,) samples: none where
        it does not shine."""
        found = {}
        for number, points in self._points.items():
            states = self._states[number]
            shines = (states != OUTSIDE) & (states != INVALID)
            found[number] = reaching = points.reaching(shines)
            of_counts = np.full(points.samples + 1, PENUMBRA, np.uint8)
            of_counts[0], of_counts[-1] = SHADOWED, LIT
            np.copyto(states, np.take(of_counts, reaching.counts), where=shines)
        return self._states, found


def _parts(number: int, light: Light, masks: bool) -> Iterator[_Part]:
    if not isinstance(light, AreaLight):
        yield _Part(number, light, True, -1)
        return
    if masks or not light.endless:
        yield _Part(number, light.shines, True, -1)
    if masks:
        return
    for index, point in enumerate(light.hard_lights()):
        yield _Part(number, point, index == 0 and light.endless, index)


def add_up(total: dict[str, int], batch: dict[str, int]) -> dict[str, int]:
    """Counters of all batches so far and those of a further one together: what is of the scene, or of the last light,
    is the latter's."""
    ways: dict[str, Callable[[int, int], int]] = dict.fromkeys(("triangles", "degenerate", "culled"), _later)
    ways |= dict.fromkeys(LARGEST, max)
    return {name: ways.get(name, operator.add)(total.get(name, 0), value) for name, value in batch.items()}


def _later(_: int, later: int) -> int:
    return later
