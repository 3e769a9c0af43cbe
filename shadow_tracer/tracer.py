# SPDX-License-Identifier: Apache-2.0
"""ShadowTracer: which pixels of a depth image does each light reach?

The public library. It checks what comes in, hands it to the device side (``gpu``), and wraps what comes out. Warp is
imported when a tracer is made, not before.
"""

from __future__ import annotations

import time
from collections.abc import Iterable
from typing import Any

import numpy as np
import numpy.typing as npt

from shadow_tracer.cone_answers import ConeAnswers
from shadow_tracer.frame_surface import FrameSurface
from shadow_tracer.gpu.accelerators.registry import AUTO, available_pipelines, resolve
from shadow_tracer.point_answers import PointAnswers
from shadow_tracer.scene.bias import Bias
from shadow_tracer.scene.bounds import Bounds
from shadow_tracer.scene.camera import Camera
from shadow_tracer.scene.checks import truth
from shadow_tracer.scene.frame_checks import Lights, check_frame
from shadow_tracer.scene.lights import Light, PointLight, SphereLight
from shadow_tracer.scene.mesh import Scene
from shadow_tracer.visibility import Frame

_VERIFIERS = ("mesh_bvh", "light_grid", "cone_hierarchy")  # that verify, if none is named


class ShadowTracer(PointAnswers, ConeAnswers):
    """Finds shadows on one device. Not thread-safe: one tracer, one thread.

    A frame ends or has never been: after an exception in the middle of one (Ctrl-C, a signal handler that raises) its
    buffers are allocated again, and the next one has the right bits. In a forked child process a tracer answers on the
    CPU; one on a GPU raises RuntimeError.

    Args:
        pipeline: one of :func:`available_pipelines`.
        variant: a variant of it; None is its default.
        device: "cpu", "cuda:0", ...; None is the best there is.
        bounds: capacities of all buffers, which are allocated here and never grow.
        front_face_culling: see the property of that name.
        graphs: whether the launches of a frame are recorded and replayed as one where the pipeline allows it
            (``cone_hierarchy/linear`` and ``light_grid`` do); :attr:`Frame.stages` then has one stage ``graph`` for
            all of them. None is yes on CUDA and no on the CPU, where recording is an experiment of Warp's. Where a
            device cannot record (it has no memory pools), or a recording fails, kernels are launched one by one.
        threads: how many cores of the CPU a frame may keep busy, where the pipeline allows it (``light_buffer``,
            ``ray_classification``, ``light_grid/spherical`` and the variants of the paper in ``cone_hierarchy`` use
            one); and how many answer about cones. None is all that this process may use, at most 8.

    Raises:
        ValueError: an unknown name, the message lists the known ones; or ``front_face_culling`` is not a bool.
        ImportError: Warp is not installed; the message says how to install it.
    """

    def __init__(
        self,
        pipeline: str = "light_grid",
        variant: str | None = None,
        device: str | None = None,
        bounds: Bounds | None = None,
        *,
        front_face_culling: bool = False,
        graphs: bool | None = None,
        threads: int | None = None,
    ) -> None:
        names = resolve(pipeline, variant)
        self._bounds = bounds or Bounds()
        try:
            from shadow_tracer.gpu.device import devices, workers
            from shadow_tracer.gpu.engine import engine
        except ModuleNotFoundError as error:
            if error.name != "warp":
                raise
            raise ImportError("shadow_tracer needs NVIDIA Warp to trace: pip install 'warp-lang>=1.19'") from error
        if threads is None:
            threads = workers.available_cores()
        elif isinstance(threads, bool) or not isinstance(threads, (int, np.integer)) or not 1 <= threads <= 64:
            raise ValueError(f"threads: expected an integer from 1 to 64, or None, got {threads!r}")
        self._engine = engine.Engine(devices.pick_device(device), self._bounds, *names, graphs, int(threads))
        # Of each set of samples what was traced last, and the answer.
        self._last: dict[str, tuple[tuple[Any, ...], Frame]] = {}
        self.front_face_culling = front_face_culling
        self.scene = Scene(self._bounds)
        """The world; change it through its methods between frames."""

    @property
    def device(self) -> str:
        """Name of the device in use."""
        return str(self._engine.device)

    @property
    def pipeline(self) -> str:
        """Name of the pipeline in use."""
        return self._engine.names[0]

    @property
    def variant(self) -> str:
        """Name of the variant in use."""
        return self._engine.names[1]

    @property
    def choice(self) -> str:
        """Pipeline ``auto``: which one has traced the last frame, and why; "" for all others."""
        chooser = self._engine.chooser
        return chooser.reason if chooser else ""

    @property
    def threads(self) -> int:
        """Cores that a frame may keep busy: 1 on CUDA, with recorded frames, and where bounds are too small to be cut
        into bands."""
        return self._engine.threads

    @property
    def bounds(self) -> Bounds:
        """Declared capacities."""
        return self._bounds

    @property
    def front_face_culling(self) -> bool:
        """Whether triangles whose front faces the light cast nothing; may be set between frames, off by default.

        The front is the side from which the corners are seen counter-clockwise. Only for closed surfaces whose fronts
        look outwards: their backs cast the same shadows on everything else, and a lit surface cannot shadow itself,
        however noisy its depth. A surface turned away from the light needs a bias of nearly zero then, for it is lit
        where the bias carries a sample to the inside. Through anything not closed, light passes from the front.
        """
        return self._culling

    @front_face_culling.setter
    def front_face_culling(self, value: bool) -> None:
        self._culling = truth(value, "front_face_culling")

    @property
    def device_bytes(self) -> int:
        """Bytes reserved on the device, those of :meth:`verify` among them."""
        return self._engine.nbytes()

    def select(self, pipeline: str, variant: str | None = None) -> None:
        """Switch to another pipeline or variant; the scene stays. The answers do not change.

        Raises:
            ValueError: an unknown name; the message lists the known ones and nothing has changed.
        """
        names = resolve(pipeline, variant)
        if names != self._engine.names:
            self._last.clear()
            self._engine.select(*names)

    def warm_up(self, cones: bool = False) -> float:
        """Compile or load every kernel by tracing a separate small scene; returns the seconds it took.

        Args:
            cones: also those of :meth:`cones` and :meth:`cone_hits`.

        Raises:
            ValueError: ``cones`` is not a bool.
        """
        if not isinstance(cones, (bool, np.bool_)):
            raise ValueError(f"cones: expected True or False, got {cones!r}")
        begin = time.perf_counter()
        chooser = self._engine.chooser
        if chooser is None:
            self._trace_triangle()
        else:
            try:
                for names in chooser.candidates:
                    chooser.forced = names
                    self._trace_triangle()
            finally:
                chooser.forced = None
            self._engine.calibrate()
        if cones:
            self._last.clear()
            self._engine.warm_up_cones(self._triangle())
        return time.perf_counter() - begin

    def _triangle(self) -> Scene:
        scene = Scene(self._bounds)
        scene.put("triangle", [(0, 0, 1), (1, 0, 1), (0, 1, 1)], [(0, 1, 2)])
        return scene

    def _trace_triangle(self, verify: bool = False) -> None:
        self._last.clear()
        scene = self._triangle()
        camera = Camera(1, 1, 1.0, 1.0, 0.0, 0.0)
        light = PointLight("lamp", (0.0, 0.0, 0.0))
        for depth in (np.full((1, 1), 2.0, np.float32), np.full((1, 1), 2000, np.uint16)):
            for bias in (Bias(0.0), Bias(0.0, normal=1.0)):
                self._engine.trace_depth(scene, depth, camera, [light], bias, verify=verify)
        scene.deform("triangle", [(0, 0, 1), (1, 0, 1), (0, 1, 1.5)])
        point = np.array([[0.1, 0.1, 2.0]])
        if not verify:
            self._engine.ask_points(scene, point, [light], 0.0)
        for each in (light, SphereLight("bulb", (0.0, 0.0, 0.0), 0.1, samples=2)):
            self._engine.trace_points(scene, point, [each], 0.0, verify=verify)

    @property
    def sample_sets(self) -> tuple[str, ...]:
        """Names of the sets of samples in use, at most ``bounds.max_sample_sets``."""
        return self._engine.sets

    def release_samples(self, samples: str) -> None:
        """Let another name have the buffers of a set of samples; nothing happens if there is none of that name."""
        self._last.pop(samples, None)
        self._engine.release_samples(samples)

    def trace(
        self,
        depth: Any,
        camera: Camera,
        lights: Iterable[Light],
        bias: Bias | float | None = None,
        samples: str = "",
    ) -> Frame:
        """Which pixels does each light reach?

        Args:
            depth: (H, W) depth along the optical axis: float32 metres (zero, negative and non-finite values are no
                measurement) or uint16 millimetres (0 is no measurement); masked pixels of a masked array are none.
            camera: intrinsics and pose; its size must be that of ``depth``.
            lights: any iterable of at least one light, with different names.
            bias: where rays start; a number is a constant in metres, None is ``Bias()``, a centimetre.
            samples: name of the set of samples, which keeps from frame to frame what can be used again (rays, where
                the image is cut between cores, the anchor of float32 numbers): with one each, two cameras in turn do
                not disturb each other. A new name takes a free set; ``bounds.max_sample_sets`` says how many there are.

        Returns:
            A :class:`Frame`; its arrays stay valid after further calls.

        Raises:
            ValueError: an argument is malformed; the message names it.
            BoundsError: the image or the number of lights exceeds the declared bounds, or no set of samples is free.
        """
        return self._trace_anew(samples, *check_frame(self._bounds, depth, camera, lights, bias))

    def verify(
        self,
        depth: Any,
        camera: Camera,
        lights: Iterable[Light],
        bias: Bias | float | None = None,
        against: str | None = None,
        samples: str = "",
    ) -> int:
        """In how many (pixel, light) pairs the answer differs from that of a second, different pipeline; 0 is right.

        The answer in question is the frame that the last :meth:`trace` returned, if it was of exactly these inputs: the
        same camera and light objects, the same bias, the same bits of depth, and nothing has changed in the scene
        since; then this costs one trace by the second pipeline. Else the frame is traced by the tracer's own pipeline
        first, as :meth:`trace` would.

        The second pipeline is given the image, the camera and the lights once more, and has separate buffers for
        samples, rays, triangle records and its search structure. It shares the copy of the scene on the device, and the
        arithmetic of a single sample and triangle: what it cannot notice is damage to these. After a difference,
        nothing that the set of samples has kept is used again.

        The first call, or :meth:`prepare_verify`, allocates its buffers; they are kept until :meth:`release_verify` or
        until :meth:`select` chooses that pipeline.

        Args:
            depth, camera, lights, bias, samples: as for :meth:`trace`.
            against: the second pipeline, in its default variant; another one than in use, and none of those that auto
                chooses among where that is in use: it may be the one that traces. None is the one prepared, or the
                first of mesh_bvh, light_grid and cone_hierarchy that this leaves.

        Returns:
            Number of pairs, at most H * W * len(lights).

        Raises:
            ValueError: an argument is malformed; the message names it.
            BoundsError: the image or the number of lights exceeds the declared bounds.
        """
        what = check_frame(self._bounds, depth, camera, lights, bias)
        names = self._verifier_for(against)
        self._engine.set_number(samples)  # what is refused allocates nothing
        self._engine.prepare_verifier(*names)
        last = self._last.get(samples)
        if last is not None and last[0] == self._key(*what) and self._engine.holds(what[0], samples):
            answer = last[1]
        else:
            answer = self._trace_anew(samples, *what)
        wrong = answer.differing(self._trace(samples, *what, verify=True))
        if wrong:
            self._engine.forget(samples)
        return wrong

    def prepare_verify(self, against: str | None = None) -> float:
        """Allocate the buffers of :meth:`verify`'s second pipeline and compile or load its kernels, so that no frame
        has to wait for it; returns the seconds it took.

        Raises:
            ValueError: ``against`` is not another pipeline than the one in use.
        """
        begin = time.perf_counter()
        self._engine.prepare_verifier(*self._verifier_for(against))
        self._trace_triangle(verify=True)
        return time.perf_counter() - begin

    def release_verify(self) -> None:
        """Free the buffers of :meth:`verify`'s second pipeline, if there are any."""
        self._engine.release_verifier()

    def _verifier_for(self, against: str | None) -> tuple[str, str]:
        """Pipeline and variant that verify, for the name that was given.

        Raises:
            ValueError: not another pipeline than the one in use.
        """
        others = [name for name in available_pipelines() if name != AUTO and name not in self._engine.pipelines]
        if against is None:
            against = self._engine.verifier or next(name for name in _VERIFIERS if name in others)
        if against not in others:
            raise ValueError(f"against: expected one of {', '.join(others)}, got {against!r}")
        return resolve(against, None)

    def _key(self, image: npt.NDArray[Any], camera: Camera, lights: Lights, bias: Bias) -> tuple[Any, ...]:
        # Cameras and lights are compared by identity: they are frozen, and those of a node are the same for both calls.
        what = (id(camera), camera), lights, bias, image.dtype
        return *what, self.scene.revision, self.front_face_culling

    def _trace_anew(self, samples: str, image: npt.NDArray[Any], camera: Camera, lights: Lights, bias: Bias) -> Frame:
        """A frame by the tracer's own pipeline: from now on the last one of a set of samples, or there is none if this
        raises."""
        self._last.pop(samples, None)
        frame = self._trace(samples, image, camera, lights, bias)
        self._last[samples] = self._key(image, camera, lights, bias), frame
        return frame

    def _trace(
        self,
        samples: str,
        image: npt.NDArray[Any],
        camera: Camera,
        lights: Lights,
        bias: Bias,
        verify: bool = False,
    ) -> Frame:
        """A frame by the tracer's own pipeline, or by the one that verifies."""
        result = self._engine.trace_depth(self.scene, image, camera, lights, bias, self._culling, verify, samples)
        names = tuple(light.name for light in lights)
        reaching = {names[number]: found.shaped(image.shape) for number, found in result.reaching.items()}
        surface = None
        if any(light.strength is not None for light in lights):
            surface = FrameSurface(image, camera, self.scene, self.device)
        return Frame(names, image.shape, result.found, result.stages, result.counters, reaching, lights, surface)
