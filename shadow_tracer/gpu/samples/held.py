# SPDX-License-Identifier: Apache-2.0
"""Samples of a frame into the buffers of those who share them, unless they are there from the frame before."""

from __future__ import annotations

from collections.abc import Hashable, Sequence
from functools import partial
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
import warp as wp

from shadow_tracer.gpu.device import forms
from shadow_tracer.gpu.device.workers import Workers
from shadow_tracer.gpu.samples.pinhole import make_pinhole
from shadow_tracer.gpu.samples.same_points import few_same, load_comparison, same_points
from shadow_tracer.gpu.samples.sample_set import SampleSet
from shadow_tracer.scene.bias import Bias
from shadow_tracer.scene.camera import Camera, RayTable
from shadow_tracer.scene.checks import FloatArray

Parts = list[tuple[SampleSet, int, int]]


class Source(NamedTuple):
    """What samples are to be made of: a depth image of this format; ``normals``: moved along them."""

    format: str
    normals: bool

    @staticmethod
    def of(depth: np.ndarray, bias: Bias) -> Source:
        """For a depth image and a bias."""
        return Source("float32" if depth.dtype == np.float32 else "uint16", bias.normal > 0.0)

    @property
    def name(self) -> str:
        """Which kernels that takes."""
        return f"{self.format} with normals" if self.normals else self.format


class Samples:
    """What the buffers hold.

    Args:
        compare: whether what comes is compared with it first, so that nothing is made again of the same. On the CPU
            that takes a tenth of the time that samples, rays and their order take; a GPU would have to be waited for.
        workers: threads that compare.
    """

    def __init__(self, compare: bool, workers: Workers | None = None) -> None:
        self._compare = compare
        self._workers = workers or Workers(1)
        self._depth: tuple[SampleSet, np.dtype[Any], int] | None = None  # where the image is, its format, its pixels
        self._source: tuple[Hashable, Parts] | None = None  # what the samples in the buffers were made of
        self._table: RayTable | None = None  # what the buffers' ray table holds

    def forget(self) -> None:
        """Others have written where they were."""
        self._depth = self._source = None

    def make_again(self) -> None:
        """Samples are made again when they come next; the image stays."""
        self._source = None

    def has_depth(self, frames: Sequence[SampleSet], depth: np.ndarray, camera: Camera, bias: Bias) -> bool:
        """Whether the samples in ``frames`` are those of a depth image."""
        source = _look(depth, camera, bias), _parts_of(frames)
        return self._compare and self._source == source and self.holds(depth)

    def put_depth(self, frames: Sequence[SampleSet], depth: np.ndarray, camera: Camera, bias: Bias) -> None:
        """A depth image, (H, W) float32 metres or uint16 millimetres, C order, of which samples are to be made."""
        self.forget()
        flat = depth.reshape(-1)
        if camera.rays is not None and camera.rays != self._table:
            self._table = None
            frames[0].upload(frames[0].ray_table, camera.rays.xy.reshape(-1, 2))
            self._table = camera.rays
        for frame in frames:
            frame.renew()
            frame.set_camera(make_pinhole(camera, bias, frame.first))
        frames[0].upload(depth_of(frames[0], depth.dtype), flat)
        self._depth = frames[0], depth.dtype, depth.size
        self._source = _look(depth, camera, bias), _parts_of(frames)

    def put_points(
        self,
        frames: Sequence[SampleSet],
        points: FloatArray,
        bias: float,
        valid: npt.NDArray[np.bool_] | None,
    ) -> bool:
        """(N, 3) points, those that are not ``valid`` are none; the depth image stays. Whether they were there, all as
        they are now."""
        parts = _parts_of(frames)
        good = (np.ones(len(points), np.bool_) if valid is None else valid).view(np.uint8)
        if self._compare and self._source == (("points", bias), parts) and self._are_there(parts, points, good):
            return True
        self._source = None
        for frame, first, size in parts:
            frame.renew()
            # On the CPU straight into the buffer: without a copy in between it takes two thirds of the time.
            rows = frame.views(frame.positions)[:size] if forms.wide(frame.device) else np.empty((size, 4))
            rows[:, :3] = points[first : first + size]
            rows[:, 3] = bias
            if not forms.wide(frame.device):
                frame.upload(frame.positions, rows)
            frame.upload(frame.valid, good[first : first + size])
        self._source = ("points", bias), parts
        return False

    def _are_there(self, parts: Parts, points: FloatArray, good: npt.NDArray[np.uint8]) -> bool:
        for frame, first, size in parts:
            some, held, valid = slice(first, first + size), frame.views(frame.positions), frame.views(frame.valid)
            if not few_same(points[some], good[some], held, valid):
                return False
        points, good = np.ascontiguousarray(points), np.ascontiguousarray(good)
        found = [False] * len(parts)

        def compare(number: int) -> None:
            frame, first, size = parts[number]
            some = slice(first, first + size)
            found[number] = same_points(points[some], good[some], frame.positions, frame.valid)

        jobs = [partial(compare, number) for number in range(len(parts))]
        load_comparison(parts[0][0].device)
        self._workers.run(jobs)
        return all(found)

    def holds(self, depth: np.ndarray) -> bool:
        """Whether ``depth`` is, bit for bit, the depth image that came last, whatever points have come since. Waits
        for the device."""
        if self._depth is None or self._depth[1:] != (depth.dtype, depth.size):
            return False
        integer = np.uint32 if depth.dtype == np.float32 else np.uint16  # as bits: NaN equals NaN
        held = self._depth[0].views(depth_of(self._depth[0], depth.dtype))[: depth.size]
        return _equal([(held.view(integer), depth.reshape(-1).view(integer))])


def depth_of(frame: SampleSet, kind: Any) -> wp.array:
    """The buffer for depth images of a format; all bands of a frame have the same one."""
    return frame.depth_metres if np.dtype(kind) == np.float32 else frame.depth_millimetres


def _look(depth: np.ndarray, camera: Camera, bias: Bias) -> Hashable:
    """What samples depend on beside the measurements and their number."""
    pose = camera.camera_to_world.tobytes()
    optics = camera.width, camera.fx, camera.fy, camera.cx, camera.cy, camera.rays
    return *optics, pose, bias, depth.dtype.str


def _parts_of(frames: Sequence[SampleSet]) -> Parts:
    return [(frame, frame.first, frame.count) for frame in frames]


def _equal(pairs: list[tuple[npt.NDArray[Any], npt.NDArray[Any]]]) -> bool:
    """Whether what is held equals what comes."""
    # Other input mostly differs in any few elements: only then all are read.
    few = all(np.array_equal(held[::997], mine[::997]) for held, mine in pairs)
    return few and all(np.array_equal(held, mine) for held, mine in pairs)
