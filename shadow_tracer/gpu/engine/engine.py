# SPDX-License-Identifier: Apache-2.0
"""Device side of a tracer: its sets of samples, the scene that they share, and what stays when a frame does not end.

An exception can reach a frame between any two steps: Ctrl-C, a signal handler that raises, a timeout, no memory. What
was half done then is not searched for but thrown away: a frame takes the :class:`FrameTracer` of all sets and the scene
out of the engine and puts them back at its end, so that after any other end the next frame finds none, and all buffers
are allocated again.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Hashable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np
import numpy.typing as npt
import warp as wp

from shadow_tracer.gpu.accelerators.registry import AUTO, asks_few, cones, for_cones
from shadow_tracer.gpu.device import forms
from shadow_tracer.gpu.device.graphs import can_record, end_recording
from shadow_tracer.gpu.device.seats import Seat
from shadow_tracer.gpu.device.workers import Workers
from shadow_tracer.gpu.engine.automatic import Chooser
from shadow_tracer.gpu.engine.bands import band_count
from shadow_tracer.gpu.engine.calibration import calibrate
from shadow_tracer.gpu.engine.costs import Names
from shadow_tracer.gpu.engine.frame import FrameTracer, Kind, Loaded, kinds_of
from shadow_tracer.gpu.engine.gather import Traced
from shadow_tracer.gpu.occluders.world import SceneBuffers
from shadow_tracer.gpu.samples.held import Source
from shadow_tracer.gpu.visibility.few_pairs import FewPairs, are_few
from shadow_tracer.scene.bias import Bias
from shadow_tracer.scene.bounds import Bounds
from shadow_tracer.scene.camera import Camera
from shadow_tracer.scene.checks import BoundsError, FloatArray
from shadow_tracer.scene.lights import Light
from shadow_tracer.scene.mesh import Scene

if TYPE_CHECKING:
    from shadow_tracer.gpu.accelerators.registry import Cones

_Result = TypeVar("_Result")
_FEW = "few pairs"  # the kernel that asks about every pair


@dataclass
class _Inside:
    """Everything on the device."""

    scene: SceneBuffers
    tracers: list[FrameTracer]  # of each set of samples
    verifier: FrameTracer | None = None  # of another pipeline, which shares nothing but the scene
    cones: Cones | None = None  # once somebody has asked about one
    few: FewPairs | None = None  # the same

    def all(self) -> list[FrameTracer]:
        """Those of the sets, and the verifier."""
        return [*self.tracers, self.verifier] if self.verifier else self.tracers


class Engine:
    """Traces frames on a device; each to the end, or as if it had never begun.

    Args:
        graphs: whether frames are recorded; None: on a GPU. Not where the device cannot.
        threads: how many bands of the rays are worked on side by side, on the CPU and where the pipeline allows it,
            and how many threads ask about cones.
    """

    def __init__(
        self, device: Any, bounds: Bounds, pipeline: str, variant: str, graphs: bool | None, threads: int = 1
    ) -> None:
        self.device = device
        self.bounds = bounds
        self._cores = threads
        self._graphs = (device.is_cuda if graphs is None else graphs) and can_record(device)
        self._workers = Workers(band_count(device, bounds, threads, self._graphs))
        self._seat = Seat(device, records=self._graphs)
        self._loaded: set[Loaded] = set()
        self._names: Names = (pipeline, variant)
        self._chooser = _chooser_of(self._names)
        self._asks_few = self._few_asked()
        self._verifier: Names | None = None
        self._sets: dict[str, int] = {}
        self._inside: _Inside | None = None
        self._seat.run(self._found)

    def _whole(self, frame: Callable[[_Inside], _Result], needs: Sequence[Hashable] = ()) -> _Result:
        """Do ``frame`` to the end; it launches the kernels ``needs``."""
        return self._seat.run(lambda: self._do(frame), needs)

    def _do(self, frame: Callable[[_Inside], _Result]) -> _Result:
        inside = self._found()
        self._inside = None
        result = frame(inside)
        self._inside = inside
        return result

    def _found(self) -> _Inside:
        if self._inside is None:
            self._workers.settle()
            if self._graphs:
                end_recording(self.device)
            if self.device.is_cuda:
                wp.synchronize_device(self.device)
            scene = SceneBuffers(self.bounds, self.device)
            made = [
                self._make(scene, self._names, self._chooser, self._graphs) for _ in range(self.bounds.max_sample_sets)
            ]
            verifier = self._make(scene, self._verifier) if self._verifier else None
            self._inside = _Inside(scene, made, verifier)
        return self._inside

    def _make(
        self, scene: SceneBuffers, names: Names, chooser: Chooser | None = None, graphs: bool = False
    ) -> FrameTracer:
        loaded = self._loaded, self._seat.loaded
        return FrameTracer(self.device, self.bounds, scene, names, chooser, graphs, self._workers, loaded)

    @property
    def inside(self) -> FrameTracer:
        """What traces the frames of the first set of samples, made again if a frame has not ended."""
        return self._seat.run(self._found).tracers[0]

    @property
    def sets(self) -> tuple[str, ...]:
        """Names of the sets of samples in use."""
        return tuple(self._sets)

    def set_number(self, samples: str | None) -> int:
        """Of the set of samples with a name, which it gets now if it is new; None is the first set, whatever its name.

        Raises:
            ValueError: no string.
            BoundsError: all sets have other names.
        """
        if samples is None:
            return 0
        if not isinstance(samples, str):
            raise ValueError(f"samples: expected a string, got {samples!r}")
        if samples not in self._sets:
            free = set(range(self.bounds.max_sample_sets)) - set(self._sets.values())
            if not free:
                raise BoundsError(
                    f"bounds.max_sample_sets: {samples!r} would be one more than {', '.join(map(repr, self._sets))}, "
                    f"but the bound is {self.bounds.max_sample_sets}"
                )
            self._sets[samples] = min(free)
        return self._sets[samples]

    def release_samples(self, samples: str) -> None:
        """Let another name have a set's buffers."""
        self._sets.pop(samples, None)

    @property
    def threads(self) -> int:
        """The most bands that are worked on side by side."""
        return self._workers.count

    @property
    def names(self) -> Names:
        """Pipeline and variant in use."""
        return self._names

    def select(self, pipeline: str, variant: str) -> None:
        """Use another pipeline from the next frame on; the old one's buffers are freed, and the verifier's if it would
        be the same. If this raises, for instance because there is no memory for old and new together, nothing has
        changed."""
        names = (pipeline, variant)
        chooser = _chooser_of(names)
        made = self._seat.run(lambda: [tracer.make_bands(names, chooser) for tracer in self._found().tracers])

        def take(inside: _Inside) -> None:
            self._names, self._chooser = names, chooser
            self._asks_few = self._few_asked()
            if self.verifier in self.pipelines:
                self._verifier = inside.verifier = None
            for tracer, bands in zip(inside.tracers, made, strict=True):
                tracer.take(*bands)

        self._whole(take)

    @property
    def pipelines(self) -> frozenset[str]:
        """Names of the pipelines that may trace a frame: several if one of them is chosen each time."""
        return frozenset(name for name, _ in self._chooser.candidates) if self._chooser else frozenset([self._names[0]])

    def _few_asked(self) -> bool:
        """Whether a few points and triangles are asked about without the pipeline."""
        candidates = self._chooser.candidates if self._chooser else [self._names]
        return forms.wide(self.device) and any(asks_few(*names) for names in candidates)

    @property
    def chooser(self) -> Chooser | None:
        """Who chooses the pipeline of each frame; None if it is always the same."""
        return self._chooser

    def calibrate(self) -> None:
        """Let the chooser see what its candidates take on this device, where they are not compared by counts."""
        if self._chooser is not None and not forms.wide(self.device):
            calibrate(self, self._chooser, self.bounds)
            # That was another image: where it lies and is cut must not matter to those that come.
            self._whole(lambda inside: inside.tracers[0].forget())

    @property
    def verifier(self) -> str | None:
        """Name of the pipeline that verifies, None if there is none."""
        return None if self._verifier is None else self._verifier[0]

    def prepare_verifier(self, pipeline: str, variant: str) -> None:
        """Allocate the buffers of another pipeline that verifies; it shares the scene. One that was there before is
        freed unless it is the same."""

        def prepare() -> None:
            inside = self._found()
            if self._verifier != (pipeline, variant):
                self._verifier = inside.verifier = None
                inside.verifier = self._make(inside.scene, (pipeline, variant))
                self._verifier = (pipeline, variant)

        self._seat.run(prepare)

    def release_verifier(self) -> None:
        """Free the buffers of the pipeline that verifies, if there is one, and what it has made of the scene."""
        self._verifier = self._seat.run(self._found).verifier = None

    def forget(self, samples: str) -> None:
        """Make everything again in the next frame of a set of samples, whatever is there."""
        number = self.set_number(samples)
        self._whole(lambda inside: inside.tracers[number].forget())

    def nbytes(self) -> int:
        """Bytes reserved on the device."""
        inside = self._seat.run(self._found)
        return inside.scene.nbytes() + sum(tracer.nbytes() for tracer in inside.all())

    def holds(self, depth: np.ndarray, samples: str | None = None) -> bool:
        """Whether ``depth`` is, bit for bit, the depth image last traced with a set of samples, whatever points have
        been asked for since. Waits for the device."""
        return self._seat.run(self._found).tracers[self.set_number(samples)].holds(depth)

    def trace_depth(
        self,
        scene: Scene,
        depth: np.ndarray,
        camera: Camera,
        lights: Sequence[Light],
        bias: Bias,
        cull: bool = False,
        verify: bool = False,
        samples: str | None = None,
    ) -> Traced:
        """States of all pixels for all lights, by the pipeline that verifies if so wished. Arguments have been checked:
        float32 metres or uint16 millimetres, C order; ``samples``: name of the set of samples, new ones get a free
        one; None is the first set, whatever its name.

        Raises:
            BoundsError: none is free.
        """
        frames = kinds_of(Source.of(depth, bias).name, lights, scene.occluders.triangle_count > 0)
        return self._trace(
            lambda tracer: tracer.trace_depth(scene, depth, camera, lights, bias, cull), verify, frames, samples
        )

    def trace_points(
        self,
        scene: Scene,
        points: FloatArray,
        lights: Sequence[Light],
        bias: float,
        valid: npt.NDArray[np.bool_] | None = None,
        cull: bool = False,
        verify: bool = False,
        samples: str | None = None,
    ) -> Traced:
        """States of (N, 3) finite points, N at most ``bounds.max_rays``; those that are not ``valid`` are INVALID, None
        is all valid. As ``trace_depth`` otherwise."""
        frames = kinds_of(None, lights, scene.occluders.triangle_count > 0)
        trace = partial(
            FrameTracer.trace_points, scene=scene, points=points, lights=lights, bias=bias, valid=valid, cull=cull
        )
        return self._trace(trace, verify, frames, samples)

    def ask_points(
        self,
        scene: Scene,
        points: FloatArray,
        lights: Sequence[Light],
        bias: float,
        valid: npt.NDArray[np.bool_] | None = None,
        cull: bool = False,
        samples: str | None = None,
    ) -> Traced:
        """As ``trace_points``, for somebody who wants states alone: no stages and counters if that is faster. Points in
        C order."""
        triangles = scene.occluders.triangle_count
        if valid is not None or not self._asks_few or not are_few(len(points), triangles, lights):
            return self.trace_points(scene, points, lights, bias, valid, cull, samples=samples)
        self.set_number(samples)

        def ask(inside: _Inside) -> npt.NDArray[np.uint8]:
            world = inside.scene
            world.sync(scene)
            if inside.few is None:
                inside.few = FewPairs(world.vertices, world.triangles)
            states = inside.few.ask(points, world.triangle_count, lights, bias, cull)
            self._seat.loaded.add(_FEW)
            return states

        return Traced(self._whole(ask, (_FEW,)), {}, {})

    def ask_cones(self, scene: Scene, question: Callable[[Cones], _Result], ignored: Collection[str] = ()) -> _Result:
        """What ``question`` finds out of what answers questions about cones, over the scene as it is, in which meshes
        of the names ``ignored`` cast nothing."""

        names = for_cones(*self._names)
        kernels = ("cones", names)

        def ask(inside: _Inside) -> _Result:
            inside.scene.sync(scene)
            if inside.cones is None:
                inside.cones = inside.scene.made.take("cones", lambda: cones(inside.scene, names, self._cores))
            if inside.scene.triangle_count:
                inside.cones.follow()  # what is made of the scene is made of all of it
                self._seat.loaded.add(kernels)
            inside.scene.leave_out(ignored)
            found = question(inside.cones)
            inside.scene.leave_out(())
            return found

        return self._whole(ask, [kernels])

    def warm_up_cones(self, scene: Scene) -> None:
        """Compile or load the kernels for cones, those that build and refit the tree among them."""
        apex, end = np.zeros((1, 3)), np.array([[0.1, 0.1, 2.0, 1.0]])
        for _ in range(2):
            self.ask_cones(scene, lambda cones: cones.outcomes(apex, end, np.full(1, 0.1), None))
            self.ask_cones(scene, lambda cones: cones.hits(apex, end, np.full(1, 0.1), 1, None))
            for mesh in list(scene):  # the second time it is elsewhere
                scene.deform(mesh.name, mesh.vertices + 0.5)

    def _trace(
        self, trace: Callable[[FrameTracer], Traced], verify: bool, frames: Sequence[Kind], samples: str | None
    ) -> Traced:
        """``frames``: the kinds of frames that this is, see ``kinds_of``."""
        if verify:

            def by_verifier(inside: _Inside) -> Traced:
                assert inside.verifier is not None
                return trace(inside.verifier)

            return self._whole(by_verifier, [(self._verifier, *frame) for frame in frames])
        number = self.set_number(samples)
        candidates = self._chooser.candidates if self._chooser else [self._names]
        needs = [(names, *frame) for names in candidates for frame in frames]
        return self._whole(lambda inside: trace(inside.tracers[number]), needs)


def _chooser_of(names: Names) -> Chooser | None:
    return Chooser() if names[0] == AUTO else None
