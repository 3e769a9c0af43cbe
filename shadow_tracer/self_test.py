# SPDX-License-Identifier: Apache-2.0
"""Does every pipeline give the right bits on this machine? A small built-in scene answers in a second or two.

The scene is made with additions, multiplications and divisions only, and the answer is a mathematical function of it,
so it is the same on every machine: ``brute_force`` is held against a checksum written down here, every other pipeline
against ``brute_force``, pixel by pixel. Where several threads work side by side a finer image is traced as well, large
enough to be shared; of four times four of its pixels, one is a pixel of the small image, ray and all.
"""

from __future__ import annotations

import math
import time
import zlib
from collections.abc import Callable, Iterable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from shadow_tracer.gpu.accelerators.registry import available_pipelines, resolve
from shadow_tracer.scene.bounds import Bounds
from shadow_tracer.scene.camera import Camera
from shadow_tracer.scene.lights import DirectionalLight, PointLight, SpotLight
from shadow_tracer.tracer import ShadowTracer
from shadow_tracer.visibility import Frame

_REFERENCE = "brute_force"
# Of the reference's states, frame after frame and light after light. test/test_self_test.py has the oracle's word for
# it.
_CHECKSUM = 0x07305A71

_WIDTH, _HEIGHT = 64, 48
_FINE = 4  # the finer image has so many times the pixels each way
# max_rays has room for eight bands, and each band too little room for the finer image alone.
_BOUNDS = Bounds(max_triangles=1024, max_rays=131072, max_lights=4, queue_capacity=4096, grid_entries=16384)
BIAS = 0.001  # [m]
LIGHTS = (
    PointLight("lamp", (0.25, -0.5, 2.0), range=2.75),
    SpotLight("spot", (-1.5, 0.5, 1.5), (1.0, -0.25, -1.0), 0.5),
    DirectionalLight("sun", (0.5, 0.25, -1.0)),
)


@dataclass(frozen=True)
class Result:
    """What a pipeline did.

    Attributes:
        pipeline, variant: which one.
        ok: whether all its bits are right.
        differing: (pixel, light) pairs whose state is wrong, over all frames; all of them if it did not answer.
        seconds: how long it took, with loading or compiling kernels.
        text: what is wrong, "" if nothing is.
    """

    pipeline: str
    variant: str
    ok: bool
    differing: int
    seconds: float
    text: str


def camera(fine: int = 1) -> Camera:
    """Two metres above the ground, looking straight down; with ``fine`` times the pixels each way."""
    pose = np.array([[1.0, 0.0, 0.0, 0.0], [0.0, -1.0, 0.0, 0.0], [0.0, 0.0, -1.0, 2.0], [0.0, 0.0, 0.0, 1.0]])
    return Camera(fine * _WIDTH, fine * _HEIGHT, fine * 40.0, fine * 40.0, fine * 31.5, fine * 23.5, pose)


def depth(fine: int = 1) -> npt.NDArray[np.float32]:
    """(H, W) metres: the ground with a step in it, and pixels without a measurement; each ``fine`` times each way."""
    image = np.full((_HEIGHT, _WIDTH), 2.0, np.float32)
    image[:, 40:] = 1.75
    image[5::11, 3::13] = np.nan
    image[2::17, 7::19] = 0.0
    return image.repeat(fine, axis=0).repeat(fine, axis=1)


def sheet(frame: int) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.int32]]:
    """(V, 3) vertices [m] and (T, 3) triangles of a rippled sheet with holes, over the ground and partly below it."""
    n = 13
    row, column = (k.reshape(-1) for k in np.mgrid[0:n, 0:n])
    ripple = (row * (5 + 2 * frame) + column * 3) % 8 / 8.0
    vertices = np.stack([column / 8.0 - 0.75, row / 8.0 - 0.75, 0.75 * ripple - 0.0625], axis=1)
    corner = (row * n + column)[(row < n - 1) & (column < n - 1) & ((row + 2 * column) % 5 > 0)]
    first, second = (np.stack(k, axis=1) for k in _halves(corner, n))
    return vertices, np.concatenate([first, second]).astype(np.int32)


def _halves(corner: npt.NDArray[np.int64], n: int) -> tuple[list[npt.NDArray[np.int64]], ...]:
    return [corner, corner + 1, corner + n + 1], [corner, corner + n + 1, corner + n]


def run(
    device: str | None = None,
    pipelines: Iterable[str] | None = None,
    progress: Callable[[str, int, int], None] | None = None,
    threads: int | None = None,
) -> list[Result]:
    """Trace the built-in scene, then a deformed one, with point, spot and directional light on every pipeline; the
    latter also in a finer image where several threads share it.

    Args:
        device: "cpu", "cuda:0", ...; None is the best there is.
        pipelines: names; None is all. ``brute_force`` is always among them, and comes first.
        progress: called before each pipeline with its name, how many are done, and how many there are.
        threads: as for :class:`ShadowTracer`.

    Returns:
        One result per pipeline, in its default variant; a pipeline that fails has a result that says so.

    Raises:
        ValueError: an unknown pipeline or device, or a wrong number of threads; the message lists the known ones.
        ImportError: Warp is not installed.
    """
    names = [name for name in (available_pipelines() if pipelines is None else pipelines) if name != _REFERENCE]
    chosen = [resolve(name, None) for name in (_REFERENCE, *names)]
    tracer = ShadowTracer(*chosen[0], device, _BOUNDS, threads=threads)
    pairs = math.prod((_WIDTH, _HEIGHT, len(LIGHTS))) * (2 if tracer.threads == 1 else 2 + _FINE**2)
    expected: list[Frame] = []
    results = []
    for done, (pipeline, variant) in enumerate(chosen):
        if progress is not None:
            progress(pipeline, done, len(chosen))
        begin = time.perf_counter()
        try:
            tracer.select(pipeline, variant)
            frames = _trace(tracer)
        except Exception as error:  # a driver or compiler may raise anything: it is this pipeline's result
            differing, text = pairs, f"did not answer: {str(error) or type(error).__name__}"
        else:
            if pipeline == _REFERENCE:
                expected = frames
            differing, text = _judge(frames, expected, pairs)
        seconds = time.perf_counter() - begin
        results.append(Result(pipeline, variant, not text, differing, seconds, text))
    return results


def _trace(tracer: ShadowTracer) -> list[Frame]:
    frames = []
    tracer.scene.clear()
    for frame in range(2):
        tracer.scene.put("sheet", *sheet(frame))
        frames.append(tracer.trace(depth(), camera(), LIGHTS, BIAS))
    if tracer.threads > 1:
        frames.append(tracer.trace(depth(_FINE), camera(_FINE), LIGHTS, BIAS))
    return frames


def _judge(frames: list[Frame], expected: list[Frame], pairs: int) -> tuple[int, str]:
    """Of all ``pairs`` those that differ, and what to say about it."""
    if not expected:
        return pairs, f"cannot be compared: {_REFERENCE} did not answer"
    if frames is expected:
        for second in frames[1:]:  # small and, if there is one, fine
            found = checksum((frames[0], second))
            if found != _CHECKSUM:
                return pairs, f"checksum {found:#010x} of its states, expected {_CHECKSUM:#010x}: nothing is sure here"
        return 0, ""
    differing = sum(got.differing(right) for got, right in zip(frames, expected, strict=True))
    return differing, f"{differing} of {pairs} states differ from {_REFERENCE}'s" if differing else ""


def checksum(frames: Iterable[Frame]) -> int:
    """CRC-32 of all states, frame after frame, light after light; of a finer image, of the pixels of the small one."""
    value = 0
    for frame in frames:
        for light in LIGHTS:
            state = frame.state(light.name)
            fine = len(state) // _HEIGHT
            value = zlib.crc32(np.ascontiguousarray(state[::fine, ::fine]).tobytes(), value)
    return value
