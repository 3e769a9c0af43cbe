# SPDX-License-Identifier: Apache-2.0
"""A set of samples on the device: buffers for all that they ask and are answered, allocated once from the declared
bounds.

Live counts are host integers where the host knows them (samples, triangles) and device integers where only the device
does (queue length, counters). Nothing here allocates per frame.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import numpy.typing as npt
import warp as wp

from shadow_tracer.gpu.device import forms
from shadow_tracer.gpu.device.counters import COUNTERS, LARGEST, ROWS
from shadow_tracer.gpu.device.launches import Launches
from shadow_tracer.gpu.device.slices import Slices
from shadow_tracer.gpu.device.transfers import HostCopies, HostValues, Uploads
from shadow_tracer.gpu.device.views import Clearing, Views
from shadow_tracer.gpu.exact.light_frame import LightFrame
from shadow_tracer.gpu.samples.pinhole import Pinhole
from shadow_tracer.scene.bounds import Bounds

# Rays that a band has room for, in parts of an even one: cuts are moved until all take equally long (``bands.py``).
_ROOM = 1.25
_LARGEST = {name: COUNTERS.index(name) for name in LARGEST}


def bounds_of_band(bounds: Bounds, bands: int) -> Bounds:
    """Capacities of one of several bands of the rays; of each list at least one place."""
    return replace(
        bounds,
        max_rays=min(bounds.max_rays, math.ceil(_ROOM * bounds.max_rays / bands)),
        grid_entries=max(1, bounds.grid_entries // bands),
    )


class SampleSet:
    """Samples of a frame and what belongs to them on the device: their rays, lights, states, queue, counters.

    Args:
        bounds: capacities.
        bands: the number of bands that the buffers can be cut into.
        whole: buffers in whose memory these are to lie, as band number ``number``.
        mirrored: whether results are packed on the device and copied to the host all at once, see ``StatePlanes``.
    """

    def __init__(
        self,
        bounds: Bounds,
        device: Any,
        bands: int = 1,
        whole: SampleSet | None = None,
        number: int = 0,
        mirrored: bool = False,
    ) -> None:
        if whole is not None:
            bounds = bounds_of_band(bounds, bands)
        self.bounds = bounds
        self.device = device
        self.number, self.bands = (number, bands) if whole is not None else (0, 1)

        def take(name: str, count: int, dtype: Any) -> wp.array:
            if whole is None:
                return wp.empty(count, dtype=dtype, device=device)
            return getattr(whole, name)[number * count : (number + 1) * count]

        self.upload: Uploads = whole.upload if whole else Uploads(device)
        self.host = HostCopies(device, mirrored)
        self.views = Views()  # on the CPU
        self.clear = Clearing(device, mirrored)
        rays = bounds.max_rays if whole else bands * bounds_of_band(bounds, bands).max_rays
        # Whole images, also for bands: a normal needs pixels beyond the cuts between them.
        self.depth_metres: wp.array = (
            whole.depth_metres if whole else wp.empty(bounds.max_rays, dtype=wp.float32, device=device)
        )
        self.depth_millimetres: wp.array = (
            whole.depth_millimetres if whole else wp.empty(bounds.max_rays, dtype=wp.uint16, device=device)
        )
        self.positions = take("positions", rays, wp.vec4d)
        self.valid = take("valid", rays, wp.uint8)
        self.rays = take("rays", rays, wp.vec4)
        # Of the whole image, also for bands: it stays when the cuts between them move.
        self.ray_table: wp.array = whole.ray_table if whole else wp.empty(bounds.max_rays, dtype=wp.vec2, device=device)
        self._pinhole = HostValues(Pinhole, 1, device)
        self._light_frames = HostValues(LightFrame, bounds.max_lights, device)
        self.pinhole = self._pinhole.array
        self.light_frame_of = [self._light_frames.array[k : k + 1] for k in range(bounds.max_lights)]
        self._lights_from = [self._light_frames.array[k:] for k in range(bounds.max_lights)]
        # Points of a light that each sample sees, as bits: where its ray was, which this question needs no more.
        self._seen = wp.array(ptr=self.rays.ptr, dtype=wp.uint64, shape=self.rays.shape, device=device)
        self.states = take("states", rays * bounds.max_lights, wp.uint8)  # light after light
        # None in the wide form, see ``visibility/answers.py``; the CUDA form has one band.
        places = 0 if forms.wide(device) else bounds.queue_capacity
        self.queue = wp.empty(places, dtype=wp.vec2i, device=device)
        self.queue_counts = self.host.add(wp.zeros(bounds.max_lights, dtype=int, device=device))
        self.queue_count_of = [self.queue_counts[k : k + 1] for k in range(bounds.max_lights)]
        # By the first light of a pass: lists that an accelerator would need to hold all of it, see Accelerator.more.
        self.parts = self.host.add(wp.zeros(bounds.max_lights, dtype=int, device=device))
        self.parts_of = [self.parts[k : k + 1] for k in range(bounds.max_lights)]
        self.counters = self.host.add(wp.zeros((ROWS, len(COUNTERS)), dtype=wp.int64, device=device))
        self.count = 0  # samples of the current frame
        self.width = 0  # of the image they come from; 0 if they are a list of points
        self.first = 0  # of all samples of the frame, the number of the first of these
        self.revision = 0  # see renew
        self._slices = Slices()
        self.launch = Launches(device)

    def set_samples(self, count: int, width: int, first: int = 0) -> None:
        """Tell how many samples these buffers have of this frame, the width of the image they come from (0: a list of
        points), and which is the first."""
        self.count, self.width, self.first = count, width, first

    def renew(self) -> None:
        """Samples or rays are about to be others than in the frame before: ``revision`` is one there has not been."""
        self.revision += 1

    def lights_from(self, light: int) -> wp.array:
        """Frames of the lights from number ``light`` on."""
        return self._lights_from[light]

    def states_of(self, light: int, lights: int = 1) -> wp.array:
        """States of all samples for ``lights`` lights from number ``light`` on, light after light."""
        return self._slices(self.states, light * self.count, lights * self.count)

    def rays_of(self, place: int) -> wp.array:
        """Rays of the light at ``place`` in its pass."""
        return self._slices(self.rays, place * self.count, self.count)

    @property
    def seen(self) -> wp.array:
        """Memory for a bit of each of 64 points and sample, which rays do not outlive: ``renew`` says so."""
        self.renew()
        return self._seen

    def mine(self, image: wp.array) -> wp.array:
        """The pixels of a whole image that belong to these samples."""
        return self._slices(image, self.first, self.count)

    def set_camera(self, pinhole: npt.NDArray[Any]) -> None:
        """Tell kernels the camera of this frame: a :class:`Pinhole` as a value of numpy, (1,)."""
        self._pinhole.put(pinhole)

    def set_lights(self, frames: Sequence[LightFrame]) -> None:
        """Tell kernels the lights of this frame; the ``number`` of each is its place."""
        self._light_frames.write(frames)

    def read_counters(self) -> dict[str, int]:
        """Counter sums by name, as they were when last asked for."""
        rows = self.host.read(self.counters)
        totals = dict(zip(COUNTERS, np.add.reduce(rows).tolist(), strict=True))
        most = np.maximum.reduce(rows)
        return totals | {name: int(most[column]) for name, column in _LARGEST.items()}

    def nbytes(self) -> int:
        """Bytes reserved on the device."""
        arrays = [a for a in vars(self).values() if isinstance(a, wp.array) and a is not self._seen]
        return sum(a.capacity for a in arrays)
