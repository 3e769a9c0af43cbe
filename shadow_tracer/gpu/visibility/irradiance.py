# SPDX-License-Identifier: Apache-2.0
"""Irradiance [W/m2] of samples, from which points of a light reach them.

Each point of a light bears its part of the light's power, with the cosines and the distance that it has from the sample
in question: which points reach matters, not only how many. Where the irradiance of the whole light has a closed form
(Lambertian discs, rectangles and spheres), the points say which part of that arrives, so the sum over all of them is as
exact as the formula, near to the lamp as well (ratio estimator: Heitz, Hill and McGuire 2018). A tube is cut into as
many pieces as it has points; pieces in a row that reach have a closed form together. All else is the sum over the
points.

The closed forms: polygons (Lambert 1760), half the sum over the edges of the angle that each spans times the cosine
between the normal and the plane of edge and sample, what is below the sample's plane being cut off first; discs, by the
integral along the rim, which is elementary where all of it is above the sample's plane, and else the regular polygon of
the same area with 64 corners; tubes (Keitz 1971), by the integral of ``sine cos_sample / distance^2`` along a line.

Everything is float64, and sums go over the points in their order, one sample at a time: neither the order of samples
nor who else asks changes a bit on the same device. CPU and CUDA differ by roundings.

What rounding costs, with u = 2^-53. A point's way v = l - p has the rounding of one subtraction a component. Its
cosine, v n, is off by at most 3 u |v|, so the whole of a term by 12 u of what a surface that faces the point would get,
and the sum by (12 + K) u of that for K points: 1e-14 for 64. Of a line of length L the places s and e along it are off
by 4 u |v|, which is 8 u K |v| / L of a K-th of it: 6e-13 for 64 pieces of 1 m at 10 m. Surfaces that the light only
grazes get less than facing ones, and the error is not less. Nothing of that is seen in float32, which rounds by 6e-8.
"""

from __future__ import annotations

import os
from typing import Any

import numpy as np
import numpy.typing as npt
import warp as wp

from shadow_tracer.gpu.device import devices, forms, native, seats
from shadow_tracer.scene.checks import FloatArray
from shadow_tracer.scene.irradiance import LAWS, Law, law_of
from shadow_tracer.scene.lights import Light

Bits = npt.NDArray[np.uint64]
_PIECE = 1 << 16  # samples that a GPU takes at once

native.constants(**{f"LAMP_{name.upper()}": number for number, name in enumerate(LAWS)})


@wp.struct
class Lamp:
    """A :class:`Law`, field by field."""

    kind: int
    count: int
    corner_count: int
    lambert: int
    two_sided: int
    rows: int
    columns: int
    scale: wp.float64
    pi: wp.float64
    radius: wp.float64
    length: wp.float64
    centre: wp.vec3d
    axis: wp.vec3d
    zero: wp.vec3d
    side: wp.vec3d
    points: wp.array(dtype=wp.vec3d)
    corners: wp.array(dtype=wp.vec3d)
    weights: wp.array(dtype=wp.float64)
    vertical: wp.array(dtype=wp.float64)
    horizontal: wp.array(dtype=wp.float64)
    values: wp.array(dtype=wp.float64)


@native.func_native("visibility/irradiance.h", calls="Irradiance::one")
def irradiance_at(
    sample: int,
    lamp: Lamp,
    positions: wp.array(dtype=wp.vec3d),
    normals: wp.array(dtype=wp.vec3d),
    bits: wp.array(dtype=wp.uint64),
) -> wp.float64:
    """Of one sample [W/m2]."""
    ...


@wp.kernel(enable_backward=False)
def find_irradiance(
    lamp: Lamp,
    positions: wp.array(dtype=wp.vec3d),
    normals: wp.array(dtype=wp.vec3d),
    bits: wp.array(dtype=wp.uint64),
    found: wp.array(dtype=wp.float64),
):
    """Of each sample, one thread each."""
    i = wp.tid()
    found[i] = irradiance_at(i, lamp, positions, normals, bits)


class _Meter:
    """Irradiances on one device, for one thread at a time."""

    def __init__(self, device: Any) -> None:
        self.seat = seats.Seat(device, records=False)
        self._device = device
        self._buffers: tuple[wp.array, ...] = ()  # positions, normals, bits and irradiances of a piece

    def read(self, law: Law, positions: FloatArray, normals: FloatArray, bits: Bits) -> FloatArray:
        """(N,) of the lights' law."""
        found = np.empty(len(positions))
        lamp = self._lamp(law)
        arrays = positions, normals, bits
        if forms.wide(self._device):
            self._launch(lamp, len(found), [self._here(array) for array in (*arrays, found)])
            return found
        if not self._buffers:
            kinds = wp.vec3d, wp.vec3d, wp.uint64, wp.float64
            self._buffers = tuple(wp.empty(_PIECE, dtype=kind, device=self._device) for kind in kinds)
        piece = len(self._buffers[0])
        for begin in range(0, len(found), piece):
            count = min(piece, len(found) - begin)
            for buffer, array in zip(self._buffers, arrays, strict=False):
                buffer[:count].assign(array[begin : begin + count])
            self._launch(lamp, count, list(self._buffers))
            found[begin : begin + count] = self._buffers[3][:count].numpy()
        return found

    def _launch(self, lamp: Lamp, count: int, arrays: list[wp.array]) -> None:
        wp.launch(find_irradiance, dim=count, inputs=[lamp, *arrays], device=self._device)

    def _here(self, array: npt.NDArray[Any]) -> wp.array:
        """The array itself, where the CPU has it."""
        dtype = wp.vec3d if array.ndim == 2 else wp.uint64 if array.dtype == np.uint64 else wp.float64
        return wp.array(ptr=array.ctypes.data, dtype=dtype, shape=len(array), device=self._device)

    def _lamp(self, law: Law) -> Lamp:
        lamp = Lamp()
        for name in ("kind", "count", "lambert", "two_sided", "scale", "radius", "length"):
            setattr(lamp, name, getattr(law, name))
        lamp.pi, lamp.corner_count = np.pi, len(law.corners)
        for name in ("centre", "axis", "zero", "side"):
            setattr(lamp, name, wp.vec3d(*getattr(law, name)))
        lamp.columns, lamp.rows = law.values.shape
        arrays = {"points": law.points, "corners": law.corners, "weights": law.weights, "vertical": law.vertical}
        arrays |= {"horizontal": law.horizontal, "values": law.values.reshape(-1)}
        for name, array in arrays.items():
            dtype = wp.vec3d if array.ndim == 2 else wp.float64
            setattr(lamp, name, wp.array(np.ascontiguousarray(array), dtype=dtype, device=self._device))
        return lamp


_meters: dict[str, _Meter] = {}
if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_meters.clear)  # nobody would release what another thread of the parent held


def irradiance_of(
    light: Light, points: FloatArray, normals: FloatArray, bits: Bits, device: str | None = None
) -> FloatArray:
    """Irradiance of one light, which has a strength.

    Args:
        light: the light.
        points: (N, 3) positions in the world [m].
        normals: (N, 3) on the side that is asked about, of any length; not finite or zero where unknown.
        bits: (N,) which of its points reach, as :meth:`ShadowTracer.light_bits` has them.
        device: where it is computed: "cpu", "cuda:0", ...; None is the best there is.

    Returns:
        (N,) float64 [W/m2]: 0 where no point reaches, whatever the normal, and where all that reach are behind the
        surface; NaN where points reach and the normal is unknown, and inside a sphere or tube and upon a point.
    """
    law = law_of(light)
    there = devices.pick_device(device)
    meter = _meters.get(str(there)) or _meters.setdefault(str(there), _Meter(there))
    places, ways = (np.ascontiguousarray(array, np.float64) for array in (points, normals))
    reach = np.ascontiguousarray(bits, np.uint64)
    if not len(places):
        return np.zeros(0)
    needs = ["irradiance"]
    found = meter.seat.run(lambda: meter.read(law, places, ways, reach), needs)
    meter.seat.loaded.update(needs)
    return found
