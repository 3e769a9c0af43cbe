# SPDX-License-Identifier: Apache-2.0
"""What a tracer says about points instead of pixels."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from shadow_tracer.scene.bias import constant_bias
from shadow_tracer.scene.bounds import Bounds
from shadow_tracer.scene.checks import FloatArray, positions_of, valid_points
from shadow_tracer.scene.frame_checks import Lights, check_bits, check_lights, check_points
from shadow_tracer.scene.irradiance import check_strengths, normals_of
from shadow_tracer.scene.lights import Light
from shadow_tracer.scene.mesh import Scene
from shadow_tracer.visibility import State, bits_of, share_of

if TYPE_CHECKING:
    from shadow_tracer.gpu.engine.engine import Engine
    from shadow_tracer.gpu.engine.gather import Traced


class PointAnswers:
    """The part of :class:`ShadowTracer` that is asked about points, in pieces of ``bounds.max_rays``."""

    scene: Scene
    _engine: Engine
    _bounds: Bounds
    _culling: bool

    def occluded(self, points: Any, light: Light, bias: float = 0.0, samples: str = "") -> npt.NDArray[np.bool_]:
        """Whether each point is in the shadow of ``light``.

        Args:
            points: (..., 3) positions in the world [m], finite; any leading shape, also none.
            light: a point, spot or directional light. Points outside its cone or range are not in its shadow.
            bias: distance from the point towards the light at which occluders begin to count [m].
            samples: as for :meth:`ShadowTracer.trace`.

        Returns:
            Boolean array of the leading shape.

        Raises:
            ValueError: wrong shape, a value that is not finite (its index is named), or not a light.
            BoundsError: no set of samples is free.
        """
        positions, flat = check_points(points, light)
        hidden = np.empty(len(flat), dtype=np.bool_)
        for piece, traced in self._pieces(flat, None, (light,), bias, samples):
            hidden[piece] = traced.states[0] == State.SHADOWED
        return hidden.reshape(positions.shape[:-1])

    def states_at(
        self, points: Any, lights: Iterable[Light], bias: float = 0.0, samples: str = ""
    ) -> npt.NDArray[np.uint8]:
        """What is known about each point and light: what :meth:`ShadowTracer.trace` says of pixels.

        Args:
            points: (..., 3) positions in the world [m]; any leading shape, also none. Those with a coordinate that is
                not finite, beyond 1e50 or masked, are INVALID.
            lights: any iterable of at least one light, with different names.
            bias: distance from the point towards the light at which occluders begin to count [m].
            samples: as for :meth:`ShadowTracer.trace`.

        Returns:
            (L, ...) uint8 array of :class:`State` values: light after light, each of the leading shape.

        Raises:
            ValueError: an argument is malformed; the message names it.
            BoundsError: more lights than declared, or no set of samples is free.
        """
        shape, flat, valid, checked = self._ask(points, lights)
        states = np.empty((len(checked), len(flat)), dtype=np.uint8)
        for piece, traced in self._pieces(flat, valid, checked, bias, samples):
            states[:, piece] = traced.states
        return states.reshape(len(checked), *shape)

    def visibility(
        self, points: Any, lights: Iterable[Light], bias: float = 0.0, samples: str = ""
    ) -> npt.NDArray[np.float32]:
        """How much of each light reaches each point.

        Args:
            points, lights, bias, samples: as for :meth:`states_at`.

        Returns:
            (L, ...) float32 array of shares from 0 to 1, as :meth:`Frame.visibility` has them: 0 outside a light, NaN
            for points that are INVALID.

        Raises:
            ValueError: an argument is malformed; the message names it.
            BoundsError: more lights than declared, or no set of samples is free.
        """
        shape, flat, valid, checked = self._ask(points, lights)
        share = np.empty((len(checked), len(flat)), dtype=np.float32)
        for piece, traced in self._pieces(flat, valid, checked, bias, samples):
            for number, states in enumerate(traced.states):
                share[number, piece] = share_of(states, traced.reaching.get(number))
        return share.reshape(len(checked), *shape)

    def light_bits(
        self, points: Any, lights: Iterable[Light], bias: float = 0.0, samples: str = ""
    ) -> npt.NDArray[np.uint64]:
        """Which points of each light reach each point.

        Args:
            points, lights, bias, samples: as for :meth:`states_at`; lights of at most 64 points.

        Returns:
            (L, ...) uint64 array, as :meth:`Frame.light_bits` has it: 0 outside a light, and for points that are
            INVALID.

        Raises:
            ValueError: an argument is malformed; the message names it.
            BoundsError: more lights than declared, or no set of samples is free.
        """
        shape, flat, valid, checked = self._ask(points, lights)
        check_bits(checked)
        return self._bits(flat, valid, checked, bias, samples).reshape(len(checked), *shape)

    def irradiance(
        self, points: Any, normals: Any, lights: Iterable[Light], bias: float = 0.0, samples: str = ""
    ) -> FloatArray:
        """How much radiation of each light falls on a surface at each point.

        Rays start at the points, ``bias`` towards the light: points of a mesh in the scene are best moved a little
        along their normals first, or their triangles hide them.

        Args:
            points, bias, samples: as for :meth:`states_at`.
            normals: (..., 3) of the side of the surface that is asked about, in the world; any length but zero, not
                finite or zero where unknown.
            lights: as for :meth:`states_at`, each with a strength and of at most 64 points.

        Returns:
            (L, ...) float64 irradiance [W/m2], light after light, each of the leading shape; float64, so that what is
            summed up over hours does not drift. 0 where no point of the light reaches, and where those that reach are
            behind the surface; NaN for points that are INVALID, inside a light, or reached with an unknown normal.

        Raises:
            ValueError: an argument is malformed, a light has no strength; the message names it.
            BoundsError: more lights than declared, or no set of samples is free.
        """
        from shadow_tracer.gpu.visibility.irradiance import irradiance_of

        shape, flat, valid, checked = self._ask(points, lights)
        check_strengths(checked)
        facing = normals_of(normals, shape)
        bits = self._bits(flat, valid, checked, bias, samples)
        device = str(self._engine.device)
        pairs = zip(checked, bits, strict=True)
        found = np.stack([irradiance_of(light, flat, facing, reach, device) for light, reach in pairs])
        if valid is not None:
            found[:, ~valid] = np.nan
        return found.reshape(len(checked), *shape)

    def _ask(
        self, points: Any, lights: Iterable[Light]
    ) -> tuple[tuple[int, ...], FloatArray, npt.NDArray[np.bool_] | None, Lights]:
        """Leading shape, finite positions (N, 3) and which of them are valid, None for all; and the lights."""
        positions, flat = positions_of(points)
        checked = check_lights(self._bounds, lights)
        valid = valid_points(flat)
        if valid is not None:
            flat = np.where(valid[:, None], flat, 0.0)
        return positions.shape[:-1], flat, valid, checked

    def _bits(
        self, flat: FloatArray, valid: npt.NDArray[np.bool_] | None, lights: Lights, bias: float, samples: str
    ) -> npt.NDArray[np.uint64]:
        """(L, N) which points of each light reach each position."""
        bits = np.empty((len(lights), len(flat)), dtype=np.uint64)
        for piece, traced in self._pieces(flat, valid, lights, bias, samples):
            for number, (light, states) in enumerate(zip(lights, traced.states, strict=True)):
                bits[number, piece] = bits_of(light.name, states, traced.reaching.get(number))
        return bits

    def _pieces(
        self, flat: FloatArray, valid: npt.NDArray[np.bool_] | None, lights: Lights, bias: float, samples: str
    ) -> Iterator[tuple[slice, Traced]]:
        """Trace the positions piece by piece."""
        constant = constant_bias(bias)

        def trace(piece: slice) -> Traced:
            some = None if valid is None else valid[piece]
            return self._engine.ask_points(
                self.scene, flat[piece], lights, constant, some, self._culling, samples=samples
            )

        most = self._bounds.max_rays
        pieces = [slice(begin, begin + most) for begin in range(0, len(flat), most)]
        return ((piece, trace(piece)) for piece in pieces)
