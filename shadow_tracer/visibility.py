# SPDX-License-Identifier: Apache-2.0
"""What is known about a depth image once it has been traced."""

from __future__ import annotations

from collections.abc import Iterable
from enum import IntEnum
from typing import Any

import numpy as np
import numpy.typing as npt

from shadow_tracer.frame_surface import FrameSurface
from shadow_tracer.gpu.visibility.light_bits import Reaching
from shadow_tracer.gpu.visibility.packed_states import PackedStates, as_bytes
from shadow_tracer.scene.checks import FloatArray
from shadow_tracer.scene.irradiance import check_strengths, normals_of
from shadow_tracer.scene.lights import Light

ByteImage = npt.NDArray[np.uint8]


class State(IntEnum):
    """What is known about a pixel and a light."""

    LIT = 0
    """Nothing stands between the sample and the light."""
    SHADOWED = 1
    """A triangle does."""
    OUTSIDE = 2
    """The sample is beyond the light's cone or range, or behind it: not lit, not shadowed, not traced."""
    INVALID = 3
    """The pixel has no depth."""
    PENUMBRA = 4
    """Some points of a light with size reach the sample, not all."""


def share_of(states: ByteImage, reaching: Reaching | None) -> npt.NDArray[np.float32]:
    """The part of a light that reaches samples of these states, NaN where they are INVALID; ``reaching`` is None for a
    light without size."""
    share = (states == State.LIT).astype(np.float32) if reaching is None else reaching.share
    share[states == State.INVALID] = np.nan
    return share


def bits_of(name: str, states: ByteImage, reaching: Reaching | None) -> npt.NDArray[np.uint64]:
    """Which points of the light ``name`` reach samples of these states; the caller's own.

    Raises:
        ValueError: it has too many points.
    """
    if reaching is None:
        return (states == State.LIT).astype(np.uint64)
    if reaching.bits is None:
        raise ValueError(f"name: expected a light of at most 64 points, got {name!r} with {reaching.samples}")
    return reaching.bits.copy()


class Frame:
    """Result of one traced depth image: a state per pixel and light, stage times and counters."""

    def __init__(
        self,
        names: tuple[str, ...],
        shape: tuple[int, int],
        found: PackedStates | ByteImage,
        stages: dict[str, float],
        counters: dict[str, int],
        reaching: dict[str, Reaching] | None = None,
        lights: Iterable[Light] = (),
        surface: FrameSurface | None = None,
    ) -> None:
        self.names = names
        """Light names in the order given to :meth:`ShadowTracer.trace`."""
        self.stages = stages
        """Milliseconds per stage, in order."""
        self.counters = counters
        """What was done for all lights together: ``rays`` traced, ``nodes_visited`` of a tree, ``accepted`` ones that a
        triangle covers, ``passes`` through a tree of rays, ``peak_queue`` entries of the fullest queue, ``leaf_tests``
        of the float32 filter, ``retested`` pairs it could not decide, ``exact`` determinants that needed expansion
        arithmetic, ``overflow_passes`` because a list was full; and of the scene: ``triangles``, ``degenerate``
        ones among them that cast nothing for the last light (no area, seen exactly edge-on, or a corner that is not
        finite), and ``culled`` ones, which cast nothing because their front faces the last light and front faces are
        culled; both of those that the pipeline looked at, which may leave out what is beside all rays."""
        self._shape = shape  # (H, W)
        self._found = found  # (L, H * W) states, or what they can be made of
        self._reaching = reaching or {}  # of lights with size: which points reach (H, W) samples
        self.lights = tuple(lights)
        """The lights in that order, as they were given."""
        self._lights = {light.name: light for light in self.lights}
        self._surface = surface  # where a light has a strength

    @property
    def _states(self) -> ByteImage:
        """(L, H, W)."""
        return as_bytes(self._found).reshape(len(self.names), *self._shape)

    def state(self, name: str) -> ByteImage:
        """(H, W) uint8 image of :class:`State` values for the light ``name``; the caller's own."""
        return self._states[self._number(name)].copy()

    def visibility(self, name: str) -> npt.NDArray[np.float32]:
        """(H, W) float32 share of the light ``name`` that reaches each pixel, from 0 to 1: 1 or 0 for lights without
        size, a multiple of ``1 / samples`` for others; 0 outside the light, NaN where depth is invalid.

        Raises:
            ValueError: no such light.
        """
        return share_of(self.state(name), self._reaching.get(name))

    def light_bits(self, name: str) -> npt.NDArray[np.uint64]:
        """(H, W) uint64: bit i is set where point i of the light ``name`` reaches (its ``points`` or ``directions``);
        a light without size has one, bit 0. 0 outside the light and where depth is invalid.

        Raises:
            ValueError: no such light, or one with more than 64 points.
        """
        return bits_of(name, self.state(name), self._reaching.get(name))

    def irradiance(self, name: str | Iterable[str] | None = None, normals: Any = None) -> npt.NDArray[np.float32]:
        """(H, W) float32 irradiance of the surface in each pixel by the light ``name`` [W/m2]: what falls on it from
        the points of the light that reach, each with its cosines and distance. It is computed in float64 and rounded
        once; float32 holds seven digits, and no lamp is known to four. 0 where no point reaches and where the surface
        is turned away; NaN where depth is invalid, and where points reach a surface of unknown normal.

        Args:
            name: a light with a strength; several, or None for all: their sum, in ascending order of names.
            normals: (H, W, 3) of the surface in the world, any length but zero, NaN where unknown; None:
                :meth:`normals`.

        Raises:
            ValueError: no such light, it has no strength or more than 64 points, or ``normals`` is malformed.
        """
        some = self.names if name is None else [name] if isinstance(name, str) else name
        names = sorted({self.names[self._number(each)] for each in some})
        lights = [self._lights[each] for each in names]
        check_strengths(tuple(lights))
        from shadow_tracer.gpu.visibility.irradiance import irradiance_of

        surface = self._seen()
        facing = normals_of(surface.normals[0] if normals is None else normals, self._shape)
        positions = surface.positions.reshape(-1, 3)
        total = np.zeros(len(positions))
        for light in lights:
            total += irradiance_of(light, positions, facing, self.light_bits(light.name).ravel(), surface.device)
        total[self._invalid().ravel()] = np.nan
        with np.errstate(over="ignore"):
            return total.astype(np.float32).reshape(self._shape)

    def normals(self, mesh: bool = True) -> FloatArray:
        """(H, W, 3) float64 unit normals of the surface in the world, on the camera's side: of the triangle that the
        pixel's ray meets first in the scene as it was traced, where the depth measured is within a twentieth of that
        triangle's; else of a plane fitted through neighbouring pixels; NaN where there is none. Computed when first
        asked for; :meth:`normal_source` says which.

        Args:
            mesh: False: those of fitted planes alone, such as where the scene holds the depth image itself.

        Raises:
            ValueError: no light of this frame has a strength.
        """
        surface = self._seen()
        return (surface.normals[0] if mesh else surface.fitted).copy()

    def normal_source(self) -> ByteImage:
        """(H, W) uint8 image of :class:`NormalSource` values: where :meth:`normals` are from.

        Raises:
            ValueError: no light of this frame has a strength.
        """
        return self._seen().normals[1].copy()

    def _seen(self) -> FrameSurface:
        if self._surface is None:
            raise ValueError("strength: no light of this frame has one, so nothing is kept of its surface")
        return self._surface

    def mask(self, name: str | None = None, unknown: int = 0) -> ByteImage:
        """(H, W) uint8 visibility mask: 255 lit, 0 in shadow or outside the light, ``unknown`` where depth is invalid.

        In the penumbra of a light with size it is ``floor(255 * visibility)``, at least 1: 255 means that all of its
        points reach, 0 that none does.

        Args:
            name: a light, or None: the largest value of any light.
            unknown: value of pixels without depth, 0 to 255.

        Raises:
            ValueError: no such light, or ``unknown`` out of range.
        """
        if not 0 <= unknown <= 255:
            raise ValueError(f"unknown: expected an integer from 0 to 255, got {unknown!r}")
        lit = self._lit(name)
        mask = np.negative(lit, out=lit)  # 1 becomes 255
        for soft in self._reaching if name is None else self._reaching.keys() & {name}:
            np.maximum(mask, self._penumbra(soft), out=mask)
        if unknown:
            mask |= self._invalid().view(np.uint8) * np.uint8(unknown)  # 0 so far: several times faster than by index
        return mask

    def _lit(self, name: str | None) -> ByteImage:
        """(H, W) 1 where the light ``name`` reaches (None: any), else 0; the caller's own."""
        number, found = None if name is None else self._number(name), self._found
        if isinstance(found, PackedStates):
            lit = found.lit_by_any() if number is None else found.lit(number)
            return lit.reshape(self._shape)
        # LIT is the least state.
        state = self._states.min(axis=0) if number is None else self._states[number]
        return (state == State.LIT).view(np.uint8)

    def _invalid(self) -> npt.NDArray[np.bool_]:
        """(H, W) where depth is invalid: there the state is INVALID for every light."""
        if isinstance(self._found, PackedStates):
            return self._found.invalid().reshape(self._shape)
        return self._states[0] == State.INVALID

    def _number(self, name: str) -> int:
        if name not in self.names:
            raise ValueError(f"name: expected one of {list(self.names)}, got {name!r}")
        return self.names.index(name)

    def bits(self) -> npt.NDArray[np.uint16]:
        """(H, W) uint16 image in which bit i is set where light i (in the order of ``names``) reaches, of one with
        size at least one point; up to 16 lights."""
        if len(self.names) > 16:
            raise ValueError(f"bits: expected at most 16 lights, got {len(self.names)}")
        bits = np.zeros(self._shape, dtype=np.uint16)
        for index, name in enumerate(self.names):
            reaches = self._lit(name)
            if name in self._reaching:
                reaches |= self.state(name) == State.PENUMBRA
            bits |= reaches.astype(np.uint16) << np.uint16(index)
        return bits

    def _penumbra(self, name: str) -> ByteImage:
        """(H, W) mask values where some points of the light reach, else 0."""
        samples = self._reaching[name].samples
        values = np.maximum(np.arange(samples + 1) * 255 // samples, 1)
        values[[0, samples]] = 0
        return values.astype(np.uint8)[self._reaching[name].counts]

    def differing(self, other: Frame) -> int:
        """In how many (pixel, light) pairs this frame and another one of the same image and lights differ, in state or
        in which points of the light reach.

        Raises:
            ValueError: the frames have different lights or sizes.
        """
        if (self.names, self._shape) != (other.names, other._shape):
            raise ValueError(
                f"other: expected a frame of the lights {list(self.names)} and shape {self._shape}, got one of "
                f"{list(other.names)} and {other._shape}"
            )
        mine, others = ({name: soft.samples for name, soft in frame._reaching.items()} for frame in (self, other))
        if mine != others:
            raise ValueError(f"other: expected a frame with samples of lights {mine}, got one with {others}")
        differ = self._states != other._states
        for name, reaching in self._reaching.items():
            differ[self.names.index(name)] |= reaching.differs(other._reaching[name])
        return int(np.count_nonzero(differ))
