# SPDX-License-Identifier: Apache-2.0
"""The answer to one depth image; masks are made from it when somebody wants them. No ROS here."""

from __future__ import annotations

import copy
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from shadow_tracer import Frame
from shadow_tracer.ros.cameras.frame_queue import WaitingFrame
from shadow_tracer.ros.cameras.mask_shape import depth_where, inverted, shadow_grown
from shadow_tracer.ros.diagnostics import Missing
from shadow_tracer.ros.settings import Settings
from shadow_tracer.ros.wire.messages import DEPTH_ENCODINGS, Intrinsics

if TYPE_CHECKING:
    from sensor_msgs.msg import CameraInfo

Mask = npt.NDArray[np.uint8]
MOST_BITS = 16


@dataclass(frozen=True, eq=False)
class Answer:
    """What is known about one depth image.

    Attributes:
        frame: the depth image.
        info: its camera_info, None if there is none.
        missing: why nothing is known; None if the frame was traced.
        names: all lights in the order of the parameter ``light_names``.
        enabled: those among them that are enabled.
        strong: those among these that have a strength.
        unknown_value: value of pixels of which nothing is known.
        traced: the tracer's result for the lights that shine; None if nothing is known or no light shines.
        optics: the intrinsics that were used, None if nothing is known.
        stages: stage -> milliseconds, in order.
        numbers: counters of the tracer.
        warning: what is doubtful about the input though it was used, "" if nothing.
        depth_casts: whether the scene that was traced holds the surface that the depth image shows.
    """

    frame: WaitingFrame
    info: CameraInfo | None
    missing: Missing | None
    names: tuple[str, ...]
    enabled: tuple[str, ...]
    strong: tuple[str, ...]
    unknown_value: int
    traced: Frame | None = None
    optics: Intrinsics | None = None
    stages: dict[str, float] = field(default_factory=dict)
    numbers: dict[str, Any] = field(default_factory=dict)
    warning: str = ""
    depth_casts: bool = False

    def mask(self, light: str | None = None) -> Mask:
        """(H, W) uint8 mask of a light, or of all together: 255 lit, 0 not reached, ``unknown_value``."""
        if self.missing is not None:
            return np.full(self.frame.depth.shape, self.unknown_value, np.uint8)
        if self.traced is not None and (light is None or light in self.traced.names):
            return self.traced.mask(light, unknown=self.unknown_value)
        return np.where(self._measured(), np.uint8(0), np.uint8(self.unknown_value))

    def grown(self, light: str | None, pixels: int) -> Mask:
        """:meth:`mask` with its shadow grown by so many pixels on every side; unknown pixels stay as they are."""
        mask = self.mask(light)
        return mask if self.missing is not None else shadow_grown(mask, self._measured(), pixels)

    def depth(self, lit: bool, pixels: int, unit: float) -> npt.NDArray[Any]:
        """(H, W) depth image as the camera sent it, valid only where light reaches, or only where none does.

        Args:
            lit: which of the two; both are invalid where nothing is known.
            pixels: by how many the shadow has grown before.
            unit: metres per step of 16UC1 and mono16.
        """
        steps = DEPTH_ENCODINGS[self.frame.image.encoding] == "u2"
        known = self._measured() & (self.missing is None)
        wanted = known & ((self.grown(None, pixels) > 0) == lit)
        return depth_where(self.frame.depth, wanted, unit, steps)

    def bits(self) -> npt.NDArray[Any]:
        """(H, W) image in which bit i is set where light i of ``names`` reaches: uint8 up to 8 lights, uint16 up to 16.

        Raises:
            ValueError: more than 16 lights.
        """
        if len(self.names) > MOST_BITS:
            raise ValueError(f"light_bits: expected at most {MOST_BITS} lights, got {len(self.names)}")
        kind = np.uint8 if len(self.names) <= 8 else np.uint16
        bits = np.zeros(self.frame.depth.shape, np.uint16)
        if self.traced is not None and self.missing is None:
            found = self.traced.bits()
            for index, name in enumerate(self.traced.names):
                bits |= ((found >> np.uint16(index)) & np.uint16(1)) << np.uint16(self.names.index(name))
        return bits.astype(kind)

    def visibility(self, light: str) -> npt.NDArray[np.float32]:
        """(H, W) float32 share of a light that reaches each pixel, 0 to 1; NaN where nothing is known."""
        if self.traced is not None and self.missing is None and light in self.traced.names:
            return self.traced.visibility(light)
        known = self._measured() & (self.missing is None)  # of a sun below the horizon nothing reaches
        return np.where(known, np.float32(0.0), np.float32(np.nan))

    def irradiance(self, light: str | None = None) -> npt.NDArray[np.float32]:
        """(H, W) float32 irradiance [W/m2] of the surface in each pixel by a light, or by all that have a strength; NaN
        where nothing is known, everywhere of a light without strength."""
        known = self._measured() & (self.missing is None)
        wanted = [name for name in self.strong if light in (None, name)]
        if not wanted or self.missing is not None:
            return np.full(known.shape, np.nan, np.float32)
        shining = [name for name in wanted if self.traced is not None and name in self.traced.names]
        if self.traced is None or not shining:  # suns below the horizon
            return np.where(known, np.float32(0.0), np.float32(np.nan))
        # Of the surface that the depth image shows, each triangle has a corner or two of noise.
        normals = self.traced.normals(mesh=False) if self.depth_casts else None
        return self.traced.irradiance(shining, normals)

    @property
    def mask_info(self) -> CameraInfo | None:
        """The camera_info with the header of the masks, so that programs which pair the two by stamp find it also where
        it was sent with another stamp; None if there is none."""
        header = self.frame.image.header
        if self.info is None or self.info.header == header:
            return self.info
        info = copy.copy(self.info)
        info.header = header
        return info

    def _measured(self) -> npt.NDArray[np.bool_]:
        depth = self.frame.depth
        measured: npt.NDArray[np.bool_] = np.isfinite(depth) & (depth > 0)
        if self.optics is not None and self.optics.rays is not None:
            measured &= self.optics.rays.known
        return measured


def published_mask(answer: Answer, light: str | None, settings: Settings) -> Mask:
    """The mask of a light, or of all together, as it is published: its shadow grown, and inverted, if so wished."""
    mask = answer.grown(light, settings.mask_dilate)
    return inverted(mask) if settings.mask_invert else mask
