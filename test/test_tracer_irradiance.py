# SPDX-License-Identifier: Apache-2.0
"""Irradiance of pixels and points behind occluders: from the points that reach, with normals of the mesh or of the
image."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import geometry
import lamps
import numpy as np
import pytest

from shadow_tracer import (
    Bias,
    Camera,
    DirectionalLight,
    DiscLight,
    NormalSource,
    PointLight,
    RectangleLight,
    ShadowTracer,
    SphereLight,
    Strength,
    TubeLight,
    render_depth,
)

WATT = Strength(power=1.0)
POINT = PointLight("a point", (0.3, 0.2, 2.0), strength=Strength(intensity=4.0))
TUBE = TubeLight("tube", (-0.6, 0.1, 2.0), (0.6, 0.1, 2.0), 0.02, strength=Strength(power=15.0))
SUN = DirectionalLight("sun", (0.1, 0.2, -1.0), strength=Strength(irradiance=900.0))
PANEL = RectangleLight("panel", (0.0, 0.0, 2.0), (0.5, 0.0, 0.0), (0.0, -0.4, 0.0), strength=Strength(exitance=math.pi))
DISC = DiscLight("disc", (0.0, 0.0, 2.0), (0.0, 0.0, -1.0), 0.5, strength=Strength(exitance=math.pi))
BULB = SphereLight("bulb", (0.0, 0.0, 2.0), 0.25, samples=64, strength=Strength(exitance=math.pi))
LIGHTS = [TUBE, POINT, SUN, PANEL]
CAMERA = Camera(40, 30, 35.0, 35.0, 19.5, 14.5, geometry.look_at((0.0, -2.0, 2.5), (0.0, 0.3, 0.0), (0, 0, 1)))


def put_room(tracer: ShadowTracer) -> None:
    """A floor, a wedge on it and a shelf under the lamps."""
    tracer.scene.put("floor", *geometry.square(2, 0.0, 3.0))
    tracer.scene.put("wedge", [(-1, 0, 0), (0, 0, 0), (0, 1, 0.6), (-1, 1, 0.6)], [(0, 1, 2), (0, 2, 3)])
    tracer.scene.put("shelf", *geometry.square(2, 1.2, 0.35, (0.2, 0.1)))


def test_points_in_every_pipeline(tracer: ShadowTracer, tracers: Any) -> None:
    random = np.random.default_rng(5)
    points = random.uniform((-1.5, -1.5, 0.0), (1.5, 1.5, 1.1), (300, 3))
    normals = random.normal(size=(300, 3))
    found = []
    for each in (tracers(tracer.device, "brute_force", "filtered"), tracer):
        each.scene.clear()
        put_room(each)
        found.append(each.irradiance(points, normals, LIGHTS, bias=0.01))
    assert found[0].shape == (4, 300) and found[0].dtype == np.float64
    assert np.array_equal(*found)
    assert (found[0] > 0.0).any(axis=1).all() and (found[0] == 0.0).any(axis=1).all()
    bits = tracer.light_bits(points, LIGHTS, bias=0.01)
    assert (found[0][bits == 0] == 0.0).all()


@pytest.mark.parametrize("light", [PANEL, DISC, BULB, TUBE], ids=["panel", "disc", "bulb", "tube"])
def test_a_lamp_half_covered_is_as_a_hundred_thousand_points_say(any_device: str, light: Any) -> None:
    """A wall hides what of the lamp lies beyond it; which part that is, is known of each piece of the lamp."""
    tracer = ShadowTracer(device=any_device)
    tracer.scene.put("wall", *geometry.quad((0.05, -9, 1.0), (9, -9, 1.0), (9, 9, 1.0), (0.05, 9, 1.0)))
    area = {"panel": 0.8, "disc": math.pi * 0.25, "bulb": 4.0 * math.pi * 0.0625, "tube": 0.04 * math.pi * 1.2}[
        light.name
    ]
    radiance = 1.0 if light is not TUBE else 15.0 / math.pi / area
    for x in (-0.1, 0.1, 0.2):
        point, normal = np.array([x, 0.05, 0.0]), geometry.unit((0.2, 0.1, 1.0))
        places, parts = lamps.contributions(light, area, point, normal, 100_000)
        crosses = point[0] + (places[:, 0] - x) / places[:, 2]  # at the height of the wall
        reaches = crosses < 0.05
        (came,) = tracer.irradiance(point, normal, [light])
        expected, whole = radiance * parts[reaches].sum(), radiance * parts.sum()
        assert came == pytest.approx(expected, abs=0.02 * whole)


def test_a_closed_room_takes_in_what_the_lamps_give_out(any_device: str) -> None:
    """The sum of irradiance times area over all surfaces of a room is the power within 1 %: what its furniture takes is
    missing on the walls."""
    tracer = ShadowTracer(device=any_device)
    tracer.scene.put("table", *geometry.box((0.5, -0.5, -1.0), (1.0, 0.5, -0.4)))
    lights = [
        replace(TUBE, start=(-1.2, -1.0, 0.5), end=(-0.4, -1.0, 0.6)),
        RectangleLight("panel", (0.6, 0.6, 0.9), (0.3, 0.0, 0.0), (0.0, -0.2, 0.0), strength=Strength(power=7.0)),
        SphereLight("bulb", (0.8, -0.8, 0.2), 0.1, samples=64, strength=Strength(power=4.0)),
    ]
    total = np.zeros(3)
    for low, high, closed in (((-1.6, -1.3, -1.0), (1.6, 1.3, 1.0), -1.0), ((0.5, -0.5, -1.0), (1.0, 0.5, -0.4), 1.0)):
        size = np.subtract(high, low)
        for axis in range(3):
            for side in (0, 1):
                across = [k for k in range(3) if k != axis]
                grid = np.stack(np.meshgrid(*((np.arange(24) + 0.5) / 24.0 for _ in across), indexing="ij"), -1)
                points = np.empty((576, 3))
                points[:, across] = np.array(low)[across] + grid.reshape(-1, 2) * size[across]
                normal = np.zeros(3)
                normal[axis] = closed * (1.0 if side else -1.0)
                points[:, axis] = (high if side else low)[axis] + 1e-6 * normal[axis]
                found = tracer.irradiance(points, np.broadcast_to(normal, points.shape), lights)
                total += found.mean(axis=1) * size[across].prod()
    assert total == pytest.approx([15.0, 7.0, 4.0], rel=0.01)


def test_what_is_unknown_is_nan_and_what_is_hidden_is_not(tracer: ShadowTracer) -> None:
    put_room(tracer)
    points = [(0.2, 0.1, 0.0), (0.2, 0.1, 0.0), (2.0, 2.0, 0.1), (2.0, 2.0, 0.1), (math.nan, 0, 0), POINT.position]
    normals = [(0, 0, 1), (math.nan, 0, 1), (0, 0, 0), (0, 0, -2), (0, 0, 1), (0, 0, 1)]
    (found,) = tracer.irradiance(points, normals, [POINT], bias=1e-3)
    assert np.array_equal(np.isnan(found), [False, False, True, False, True, True])
    assert np.array_equal(found[[0, 1, 3]], [0.0, 0.0, 0.0])


def test_pixels_are_points(tracer: ShadowTracer) -> None:
    """The image has what points at the same places with the same normals have, rounded once; the sum of all lights does
    not depend on their order."""
    put_room(tracer)
    depth, _ = render_depth(tracer.scene, CAMERA, tracer.device)
    depth[3, 4:9] = np.nan
    bias = Bias(0.01)
    frame = tracer.trace(depth, CAMERA, LIGHTS, bias)
    again = tracer.trace(depth, CAMERA, LIGHTS[::-1], bias)
    points = CAMERA.unproject(depth)
    each = tracer.irradiance(points, frame.normals(), LIGHTS, bias=0.01)
    for light, expected in zip(LIGHTS, each, strict=True):
        came = frame.irradiance(light.name)
        assert came.dtype == np.float32 and came.shape == (30, 40)
        assert np.array_equal(came, expected.astype(np.float32), equal_nan=True)
        assert np.array_equal(np.isnan(came), np.isnan(depth))
    assert np.array_equal(frame.irradiance(), again.irradiance(), equal_nan=True)
    assert frame.irradiance()[20, 20] == pytest.approx(sum(each)[20, 20])
    assert np.array_equal(frame.irradiance("tube", frame.normals()), frame.irradiance("tube"), equal_nan=True)


def test_normals_are_the_meshs_where_it_is_seen(tracer: ShadowTracer) -> None:
    put_room(tracer)
    depth, triangle = render_depth(tracer.scene, CAMERA, tracer.device)
    depth[:6] = 1.0  # something nearer that no mesh knows: a plane across the camera's view
    depth[2, 20] = 0.0
    frame = tracer.trace(depth, CAMERA, [POINT])
    tracer.scene.clear()  # whatever happens afterwards
    source, normals = frame.normal_source(), frame.normals()
    assert (source[8:] == NormalSource.MESH).all()
    assert np.array_equal(normals[(triangle < 2) & (source == NormalSource.MESH)][0], [0.0, 0.0, 1.0])
    wedge = (triangle >= 2) & (triangle < 4) & (source == NormalSource.MESH)
    assert normals[wedge] == pytest.approx(np.broadcast_to(geometry.unit((0, -0.6, 1.0)), (wedge.sum(), 3)))
    assert source[2, 20] == NormalSource.NONE and np.isnan(normals[2, 20]).all()
    assert source[1, 10] == NormalSource.FITTED
    assert normals[1, 10] == pytest.approx(-CAMERA.camera_to_world[:3, 2], abs=1e-6)
    assert math.isnan(frame.irradiance("a point")[2, 20])


def test_normals_look_at_the_camera_however_corners_go_around(reference: ShadowTracer) -> None:
    corners, triangles = geometry.square(2, 0.0, 3.0)
    found = []
    for winding in (triangles, triangles[:, ::-1]):
        reference.scene.put("floor", corners, winding)
        depth, _ = render_depth(reference.scene, CAMERA, reference.device)
        frame = reference.trace(depth, CAMERA, [POINT])
        assert (frame.normal_source()[10:] == NormalSource.MESH).all()
        found.append(frame.irradiance("a point"))
    assert np.array_equal(*found, equal_nan=True) and (found[0] > 0.0).sum() > 500


def test_uint16_millimetres(reference: ShadowTracer) -> None:
    put_room(reference)
    depth, _ = render_depth(reference.scene, CAMERA, reference.device)
    millimetres = np.round(1000.0 * np.nan_to_num(depth)).astype(np.uint16)
    metres = reference.trace(millimetres.astype(np.float32) / 1000.0, CAMERA, [POINT]).irradiance("a point")
    came = reference.trace(millimetres, CAMERA, [POINT]).irradiance("a point")
    assert came[5:] == pytest.approx(metres[5:], rel=1e-5) and (came > 0.0).sum() > 100


def test_the_callers_image_may_be_used_again(reference: ShadowTracer) -> None:
    put_room(reference)
    depth, _ = render_depth(reference.scene, CAMERA, reference.device)
    frame, other = (reference.trace(depth, CAMERA, [POINT]) for _ in range(2))
    expected = other.irradiance("a point")
    depth[:] = 0.3
    assert np.array_equal(frame.irradiance("a point"), expected, equal_nan=True)


def test_a_light_without_strength_has_no_irradiance(reference: ShadowTracer) -> None:
    put_room(reference)
    dark = PointLight("dark", (0, 0, 2))
    says = "strength: the light 'dark' has none, so there is no irradiance; give it strength=Strength"
    with pytest.raises(ValueError, match=says):
        reference.irradiance((0, 0, 0), (0, 0, 1), [dark])
    frame = reference.trace(np.ones((30, 40), np.float32), CAMERA, [dark, POINT])
    for name in ("dark", None):
        with pytest.raises(ValueError, match=says):
            frame.irradiance(name)
    with pytest.raises(ValueError, match="name: expected one of"):
        frame.irradiance("lamp")
    with pytest.raises(ValueError, match=r"normals: expected real numbers of shape \(30, 40, 3\)"):
        frame.irradiance("a point", np.zeros((3, 3)))
    with pytest.raises(ValueError, match="strength: no light of this frame has one"):
        reference.trace(np.ones((30, 40), np.float32), CAMERA, [dark]).normals()
    many = SphereLight("many", (0, 0, 2), 0.1, samples=65, strength=WATT)
    with pytest.raises(ValueError, match="samples: expected at most 64 points"):
        reference.irradiance((0, 0, 0), (0, 0, 1), [many])
