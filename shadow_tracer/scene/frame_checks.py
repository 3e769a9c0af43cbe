# SPDX-License-Identifier: Apache-2.0
"""What a frame is asked about, checked."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np
import numpy.typing as npt

from shadow_tracer.scene.area_lights import MOST_BITS
from shadow_tracer.scene.bias import Bias
from shadow_tracer.scene.bounds import Bounds
from shadow_tracer.scene.camera import Camera
from shadow_tracer.scene.checks import LARGEST, BoundsError, FloatArray, positions_of, unmasked_depth, valid_points
from shadow_tracer.scene.lights import AreaLight, DirectionalLight, Light, PointLight, SpotLight

_HARD = (PointLight, SpotLight, DirectionalLight)
_LIGHTS = (*_HARD, AreaLight)
Lights = tuple[Light, ...]
_USUAL = Bias()


def check_frame(
    bounds: Bounds, depth: Any, camera: Camera, lights: Iterable[Light], bias: Bias | float | None
) -> tuple[npt.NDArray[Any], Camera, Lights, Bias]:
    """Depth image (C order), camera, lights and bias of a frame.

    Raises:
        ValueError: an argument is malformed; the message names it.
        BoundsError: the image or the number of lights exceeds the bounds.
    """
    image = unmasked_depth(depth)
    if image.ndim != 2:
        raise ValueError(f"depth: expected shape (H, W), got {image.shape}")
    if image.dtype not in (np.float32, np.uint16):
        raise ValueError(f"depth: expected dtype float32 (metres) or uint16 (millimetres), got {image.dtype}")
    if not isinstance(camera, Camera):
        raise ValueError(f"camera: expected a Camera, got {type(camera).__name__}")
    if image.shape != (camera.height, camera.width):
        raise ValueError(f"depth: expected shape {(camera.height, camera.width)} as the camera has, got {image.shape}")
    if image.size > bounds.max_rays:
        raise BoundsError(
            f"bounds.max_rays: the image has {camera.width} x {camera.height} = {image.size} pixels, "
            f"but the bound is {bounds.max_rays}"
        )
    checked = check_lights(bounds, lights)
    if bias is None:
        bias = _USUAL
    elif not isinstance(bias, Bias):
        bias = Bias(constant=bias)
    return np.ascontiguousarray(image), camera, checked, bias


def check_lights(bounds: Bounds, lights: Iterable[Light]) -> Lights:
    """At least one light, with different names.

    Raises:
        ValueError: not lights.
        BoundsError: too many.
    """
    if isinstance(lights, _LIGHTS):
        raise ValueError("lights: expected an iterable of lights, got a single light; write [light]")
    if not isinstance(lights, Iterable):
        raise ValueError(f"lights: expected an iterable of lights, got {type(lights).__name__}")
    checked = tuple(lights)  # read once: it may be a generator
    for index, light in enumerate(checked):
        _check_light(light, f"lights[{index}]")
    names = [light.name for light in checked]
    if not names:
        raise ValueError("lights: expected at least one light, got none")
    if len(set(names)) != len(names):
        raise ValueError(f"lights: expected different names, got {names}")
    if len(names) > bounds.max_lights:
        raise BoundsError(f"bounds.max_lights: got {len(names)} lights, but the bound is {bounds.max_lights}")
    return checked


def check_points(points: Any, light: Light) -> tuple[FloatArray, FloatArray]:
    """Positions of any leading shape, and the same as (N, 3), that are to be asked about a hard light.

    Raises:
        ValueError: wrong shape, a value that is not finite (its index is named), or not a hard light.
    """
    positions, flat = positions_of(points)
    valid = valid_points(flat)
    if valid is not None:
        bad = int(np.flatnonzero(~valid)[0])
        where = tuple(int(k) for k in np.unravel_index(bad, positions.shape[:-1]))
        raise ValueError(
            f"points: expected finite positions of at most {LARGEST:g}, got {flat[bad].tolist()} at index {where} "
            f"and {int((~valid).sum())} such points in all; select the finite ones first"
        )
    if not isinstance(light, _HARD):
        hint = "; states_at says where none, some or all of it reaches" if isinstance(light, AreaLight) else ""
        got = type(light).__name__
        raise ValueError(f"light: expected a PointLight, SpotLight or DirectionalLight, got {got}{hint}")
    return positions, flat


def _check_light(light: Any, field: str) -> None:
    if not isinstance(light, _LIGHTS):
        raise ValueError(f"{field}: expected a light such as PointLight, got {type(light).__name__}")


def check_bits(lights: Lights) -> None:
    """Lights of which each point has a bit. Raises ValueError."""
    for index, light in enumerate(lights):
        if isinstance(light, AreaLight) and light.samples > MOST_BITS:
            raise ValueError(
                f"lights[{index}]: expected a light of at most {MOST_BITS} points, got {light.name!r} with "
                f"{light.samples}"
            )
