# SPDX-License-Identifier: Apache-2.0
"""ShadowTracer: which pixels of a depth image does each light reach?

The public library. It checks what comes in, hands it to the device side (``gpu``), and wraps what comes out. Warp is
imported when a tracer is made, not before.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass
from enum import IntEnum
from typing import Any

import numpy as np
import numpy.typing as npt

from shadow_tracer.gpu.pipelines import resolve
from shadow_tracer.scene.bounds import Bounds
from shadow_tracer.scene.camera import Camera
from shadow_tracer.scene.checks import LARGEST, BoundsError, FloatArray, finite
from shadow_tracer.scene.lights import DirectionalLight, Light, PointLight, SpotLight
from shadow_tracer.scene.mesh import Scene

ByteImage = npt.NDArray[np.uint8]


class State(IntEnum):
    """What is known about a pixel and a light."""

    LIT = 0
    """Nothing stands between the sample and the light."""
    SHADOWED = 1
    """A triangle does."""
    OUTSIDE = 2
    """The sample is beyond the light's cone or range: not lit, not shadowed, not traced."""
    INVALID = 3
    """The pixel has no depth."""


@dataclass(frozen=True)
class Bias:
    """How far a ray starts from its sample, towards the light: ``constant + quadratic * z**2`` with z the depth [m].

    Measured depth lies before and behind the true surface, so without a bias surfaces shadow themselves; stereo and
    structured light noise grows with z squared.

    Args:
        constant: metres, at least 0.
        quadratic: metres per square metre, at least 0.

    Raises:
        ValueError: a value is negative or not finite; the message names it.
    """

    constant: float = 0.01
    quadratic: float = 0.0

    def __post_init__(self) -> None:
        for name in ("constant", "quadratic"):
            value = finite(getattr(self, name), f"bias.{name}")
            if not 0.0 <= value <= LARGEST:
                raise ValueError(f"bias.{name}: expected a number from 0 to {LARGEST:g}, got {value!r}")
            object.__setattr__(self, name, value)


class Frame:
    """Result of one traced depth image: a state per pixel and light, stage times and counters."""

    def __init__(
        self, names: tuple[str, ...], states: npt.NDArray[np.uint8], stages: dict[str, float], counters: dict[str, int]
    ) -> None:
        self.names = names
        """Light names in the order given to :meth:`ShadowTracer.trace`."""
        self.stages = stages
        """Milliseconds per stage, in order."""
        self.counters = counters
        """What was done for all lights together: ``rays`` traced, ``nodes_visited`` of a tree, ``accepted`` ones that a
        triangle covers, ``passes`` through a tree of rays, ``peak_queue`` entries of the fullest queue, ``leaf_tests``
        of the float32 filter, ``retested`` pairs it could not decide, ``exact`` determinants that needed expansion
        arithmetic, ``overflow_passes`` because the queue was full; and of the scene: ``triangles``, ``degenerate``
        ones among them that cast nothing for the last light (no area, seen exactly edge-on, or a corner that is not
        finite), and ``culled`` ones, which cast nothing because their front faces the last light and front faces are
        culled."""
        self._states = states

    def state(self, name: str) -> ByteImage:
        """(H, W) uint8 image of :class:`State` values for the light ``name``."""
        if name not in self.names:
            raise ValueError(f"name: expected one of {list(self.names)}, got {name!r}")
        return self._states[self.names.index(name)]

    def mask(self, name: str | None = None, unknown: int = 0) -> ByteImage:
        """(H, W) uint8 visibility mask: 255 lit, 0 in shadow or outside the light, ``unknown`` where depth is invalid.

        Args:
            name: a light, or None: 255 where at least one light reaches.
            unknown: value of pixels without depth, 0 to 255.

        Raises:
            ValueError: no such light, or ``unknown`` out of range.
        """
        if not 0 <= unknown <= 255:
            raise ValueError(f"unknown: expected an integer from 0 to 255, got {unknown!r}")
        # LIT is the least state, and a pixel without depth is INVALID for every light.
        state = self._states.min(axis=0) if name is None else self.state(name)
        mask: ByteImage = np.negative((state == State.LIT).view(np.uint8))  # 1 becomes 255
        if unknown:
            mask[state == State.INVALID] = unknown
        return mask

    def bits(self) -> npt.NDArray[np.uint16]:
        """(H, W) uint16 image in which bit i is set where light i (in the order of ``names``) reaches; up to 16
        lights."""
        if len(self.names) > 16:
            raise ValueError(f"bits: expected at most 16 lights, got {len(self.names)}")
        bits = np.zeros(self._states.shape[1:], dtype=np.uint16)
        for index in range(len(self.names)):
            bits |= (self._states[index] == State.LIT).astype(np.uint16) << np.uint16(index)
        return bits


class ShadowTracer:
    """Finds shadows on one device. Not thread-safe: one tracer, one thread.

    Args:
        pipeline: one of :func:`available_pipelines`.
        variant: a variant of it; None is its default.
        device: "cpu", "cuda:0", ...; None is the best there is.
        bounds: capacities of all buffers, which are allocated here and never grow.
        front_face_culling: see the property of that name.
        graphs: whether the launches of a frame are recorded and replayed as one where the pipeline allows it
            (``cone_hierarchy/linear`` and ``light_grid`` do); :attr:`Frame.stages` then has one stage ``graph`` for
            all of them. None is yes on CUDA and no on the CPU, where recording is an experiment of Warp's.

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
    ) -> None:
        self._names = resolve(pipeline, variant)
        self._bounds = bounds or Bounds()
        try:
            from shadow_tracer.gpu import devices, engine
        except ModuleNotFoundError as error:
            if error.name != "warp":
                raise
            raise ImportError("shadow_tracer needs NVIDIA Warp to trace: pip install 'warp-lang>=1.19'") from error
        self._engine = engine.Engine(devices.pick_device(device), self._bounds, *self._names, graphs)
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
        return self._names[0]

    @property
    def variant(self) -> str:
        """Name of the variant in use."""
        return self._names[1]

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
        return self._engine.front_face_culling

    @front_face_culling.setter
    def front_face_culling(self, value: bool) -> None:
        if not isinstance(value, (bool, np.bool_)):
            raise ValueError(f"front_face_culling: expected True or False, got {value!r}")
        self._engine.front_face_culling = bool(value)

    @property
    def device_bytes(self) -> int:
        """Bytes reserved on the device."""
        return self._engine.nbytes()

    def select(self, pipeline: str, variant: str | None = None) -> None:
        """Switch to another pipeline or variant; the scene stays. The answers do not change.

        Raises:
            ValueError: an unknown name; the message lists the known ones and nothing has changed.
        """
        names = resolve(pipeline, variant)
        if names != self._names:
            self._engine.select(*names)
            self._names = names

    def warm_up(self) -> float:
        """Compile or load every kernel by tracing a small scene of its own; returns the seconds it took."""
        begin = time.perf_counter()
        scene = Scene(self._bounds)
        scene.put("triangle", [(0, 0, 1), (1, 0, 1), (0, 1, 1)], [(0, 1, 2)])
        camera = Camera(1, 1, 1.0, 1.0, 0.0, 0.0)
        light = PointLight("lamp", (0.0, 0.0, 0.0))
        for depth in (np.full((1, 1), 2.0, np.float32), np.full((1, 1), 2000, np.uint16)):
            self._engine.trace_depth(scene, depth, camera, [light], (0.0, 0.0))
        scene.deform("triangle", [(0, 0, 1), (1, 0, 1), (0, 1, 1.5)])
        self._engine.trace_points(scene, np.array([[0.1, 0.1, 2.0]]), light, 0.0)
        return time.perf_counter() - begin

    def occluded(self, points: Any, light: Light, bias: float = 0.0) -> npt.NDArray[np.bool_]:
        """Whether each point is in the shadow of ``light``.

        Args:
            points: (..., 3) positions in the world [m], finite; any leading shape, also none.
            light: a point, spot or directional light. Points outside its cone or range are not in its shadow.
            bias: distance from the point towards the light at which occluders begin to count [m].

        Returns:
            Boolean array of the leading shape.

        Raises:
            ValueError: wrong shape, a value that is not finite (its index is named), or not a light.
        """
        positions = np.asarray(points)
        if positions.ndim == 0 or positions.shape[-1] != 3 or positions.dtype.kind not in "fiu":
            raise ValueError(
                f"points: expected real numbers of shape (..., 3), got shape {positions.shape} of {positions.dtype}"
            )
        flat = np.ascontiguousarray(positions, dtype=np.float64).reshape(-1, 3)
        finite_rows = (np.abs(flat) <= LARGEST).all(axis=1)
        if not finite_rows.all():
            bad = int(np.flatnonzero(~finite_rows)[0])
            where = tuple(int(k) for k in np.unravel_index(bad, positions.shape[:-1]))
            raise ValueError(
                f"points: expected finite positions of at most {LARGEST:g}, got {flat[bad].tolist()} at index {where} "
                f"and {int((~finite_rows).sum())} such points in all; select the finite ones first"
            )
        _check_light(light, "light")
        constant = Bias(constant=bias).constant
        hidden = np.empty(len(flat), dtype=np.bool_)
        for begin in range(0, len(flat), self._bounds.max_rays):
            piece = slice(begin, begin + self._bounds.max_rays)
            hidden[piece] = (
                self._engine.trace_points(self.scene, flat[piece], light, constant).states[0] == State.SHADOWED
            )
        return hidden.reshape(positions.shape[:-1])

    def trace(self, depth: Any, camera: Camera, lights: Sequence[Light], bias: Bias | float | None = None) -> Frame:
        """Which pixels does each light reach?

        Args:
            depth: (H, W) depth along the optical axis: float32 metres (zero, negative and non-finite values are no
                measurement) or uint16 millimetres (0 is no measurement).
            camera: intrinsics and pose; its size must be that of ``depth``.
            lights: at least one, with different names.
            bias: where rays start; a number is a constant in metres, None is ``Bias()``, a centimetre.

        Returns:
            A :class:`Frame`; its arrays stay valid after further calls.

        Raises:
            ValueError: an argument is malformed; the message names it.
            BoundsError: the image or the number of lights exceeds the declared bounds.
        """
        image = np.asarray(depth)
        if image.ndim != 2:
            raise ValueError(f"depth: expected shape (H, W), got {image.shape}")
        if image.dtype not in (np.float32, np.uint16):
            raise ValueError(f"depth: expected dtype float32 (metres) or uint16 (millimetres), got {image.dtype}")
        if not isinstance(camera, Camera):
            raise ValueError(f"camera: expected a Camera, got {type(camera).__name__}")
        if image.shape != (camera.height, camera.width):
            raise ValueError(
                f"depth: expected shape {(camera.height, camera.width)} as the camera has, got {image.shape}"
            )
        if image.size > self._bounds.max_rays:
            raise BoundsError(
                f"bounds.max_rays: the image has {camera.width} x {camera.height} = {image.size} pixels, "
                f"but the bound is {self._bounds.max_rays}"
            )
        names = self._check_lights(lights)
        if bias is None:
            bias = Bias()
        elif not isinstance(bias, Bias):
            bias = Bias(constant=bias)
        result = self._engine.trace_depth(
            self.scene, np.ascontiguousarray(image), camera, list(lights), (bias.constant, bias.quadratic)
        )
        return Frame(names, result.states.reshape(len(names), *image.shape), result.stages, result.counters)

    def _check_lights(self, lights: Sequence[Light]) -> tuple[str, ...]:
        if isinstance(lights, (PointLight, SpotLight, DirectionalLight)):
            raise ValueError("lights: expected a sequence of lights, got a single light; write [light]")
        for index, light in enumerate(lights):
            _check_light(light, f"lights[{index}]")
        names = tuple(light.name for light in lights)
        if not names:
            raise ValueError("lights: expected at least one light, got none")
        if len(set(names)) != len(names):
            raise ValueError(f"lights: expected different names, got {list(names)}")
        if len(names) > self._bounds.max_lights:
            raise BoundsError(f"bounds.max_lights: got {len(names)} lights, but the bound is {self._bounds.max_lights}")
        return names


def _check_light(light: Any, field: str) -> FloatArray:
    if not isinstance(light, (PointLight, SpotLight, DirectionalLight)):
        raise ValueError(f"{field}: expected a PointLight, SpotLight or DirectionalLight, got {type(light).__name__}")
    return light.homogeneous
