# SPDX-License-Identifier: Apache-2.0
"""Points and triangles so few that every pair is asked about, in one launch.

A frame is a dozen launches, and where there is little to do Python takes longer about each of them than its kernel.
Here nothing is kept of points or lights, so there is nothing to look after: one kernel makes the frame of the light,
records and rays, and asks the filter and the exact decision, as ``brute_force`` does (``every_pair.h``).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import cast

import numpy as np
import numpy.typing as npt
import warp as wp

from shadow_tracer.gpu.device import native
from shadow_tracer.gpu.device.launches import Launches
from shadow_tracer.gpu.exact import decision, records  # noqa: F401 (headers name their constants)
from shadow_tracer.gpu.exact.light_frame import LightFrame, look
from shadow_tracer.scene.checks import FloatArray
from shadow_tracer.scene.lights import AreaLight, HardLight, Light

# A pair takes 0.28 ns with AVX-512, 0.40 with AVX2, a point 16; all the rest 70 us. ``light_grid`` takes 330 us more,
# and 60 ns a triangle as long as these are few: as much as 150 pairs. (docs/performance.md, "A call about few rays";
# counts decide, so that no time ever does.)
MOST_PAIRS = 1_150_000
_PAIRS_OF_A_TRIANGLE, _OF_TRIANGLES = 150, 4_000
MOST_POINTS = 32_767  # of more, two threads may each have 16,384


@wp.struct
class Asked:
    """What is asked."""

    light: LightFrame  # what is said of the light; the rest is found
    bias: wp.float64
    points: wp.uint64  # where they are
    states: wp.uint64  # where the answers are to be
    count: int
    triangle_count: int
    cull: int


@native.func_native("visibility/every_pair.h", calls="EveryPair::ask")
def every_pair(
    light: LightFrame,
    bias: wp.float64,
    cull: int,
    triangle_count: int,
    points: wp.array(dtype=wp.vec3d),
    vertices: wp.array(dtype=wp.vec3d),
    triangles: wp.array(dtype=wp.vec3i),
    states: wp.array(dtype=wp.uint8),
):
    """States of points for a light."""
    ...


@wp.kernel(enable_backward=False)
def ask_every_pair(
    asked: wp.array(dtype=Asked), vertices: wp.array(dtype=wp.vec3d), triangles: wp.array(dtype=wp.vec3i)
):
    """One thread, of the CPU."""
    ask = asked[0]
    points = wp.array(ptr=ask.points, shape=(ask.count,), dtype=wp.vec3d)
    states = wp.array(ptr=ask.states, shape=(ask.count,), dtype=wp.uint8)
    every_pair(ask.light, ask.bias, ask.cull, ask.triangle_count, points, vertices, triangles, states)


def are_few(points: int, triangles: int, lights: Sequence[Light]) -> bool:
    """Whether to ask about every pair takes less time than anything else, and can be done: lights are hard, and all
    meshes cast shadows in them."""
    most = MOST_PAIRS + _PAIRS_OF_A_TRIANGLE * min(triangles, _OF_TRIANGLES)
    few = 0 < points <= MOST_POINTS and 0 < points * triangles * len(lights) <= most
    return few and not any(light.ignore or isinstance(light, AreaLight) for light in lights)


class FewPairs:
    """Asks about few points, in the wide form.

    Args:
        vertices, triangles: where those of the world are.
    """

    def __init__(self, vertices: wp.array, triangles: wp.array) -> None:
        self._launch = Launches(vertices.device)
        asked = wp.zeros(1, dtype=Asked, device=vertices.device)
        self._inputs = [asked, vertices, triangles]
        fields = asked.numpy()
        self._light, self._bias, self._cull = fields["light"], fields["bias"], fields["cull"]
        self._points, self._states = fields["points"], fields["states"]
        self._count, self._triangle_count = fields["count"], fields["triangle_count"]
        self._known: Light | None = None

    def ask(
        self, points: FloatArray, triangle_count: int, lights: Sequence[Light], bias: float, cull: bool
    ) -> npt.NDArray[np.uint8]:
        """(L, N) states of (N, 3) finite points in C order, for so many triangles and lights as in ``are_few``.
        ``cull``: triangles whose front faces the light cast nothing."""
        states = np.empty((len(lights), len(points)), np.uint8)
        self._bias[0], self._cull[0] = bias, cull
        self._points[0] = points.__array_interface__["data"][0]
        self._count[0], self._triangle_count[0] = len(points), triangle_count
        place = states.__array_interface__["data"][0]
        for number, light in enumerate(lights):
            self._see(light)
            self._states[0] = place + number * len(points)
            self._launch(ask_every_pair, (), lambda: (1, self._inputs))
        return states

    def _see(self, light: Light) -> None:
        if light is self._known:  # nobody changes a light
            return
        fields = self._light
        fields["light"][0], fields["axis"][0], fields["cosine"], fields["reach"] = look(cast(HardLight, light))
        self._known = light
