# SPDX-License-Identifier: Apache-2.0
"""Shadow maps: what a texel holds, against exact depth images; which rasteriser draws does not matter."""

from __future__ import annotations

import numpy as np
import pytest
import shadow_map
from procedural import SCENES, look_at

from shadow_tracer import Camera, DirectionalLight, PointLight, Scene, render_depth

_SIZE = 64
_MADE = SCENES["stadium"](900, frames=2)
_CENTRE = np.asarray(_MADE.lights["inside"].position)
_AROUND = _CENTRE + np.random.default_rng(0).normal(size=(200, 3))
_SUN = DirectionalLight("sun", (0.3, -0.5, -0.8))


def _mesh() -> tuple[np.ndarray, np.ndarray]:
    return _MADE.positions[0], _MADE.triangles


def _gl() -> shadow_map.GlRasteriser:
    pytest.importorskip("moderngl", reason="OpenGL needs moderngl")
    try:
        return shadow_map.GlRasteriser(*_mesh())
    except Exception as error:
        pytest.skip(f"no OpenGL here: {error}")


def test_a_cube_of_maps_divides_the_samples() -> None:
    parts = [mine for _, mine in shadow_map.sides(PointLight("lamp", _CENTRE), _AROUND)]
    assert len(parts) == 6 and np.array_equal(np.sum(parts, axis=0), np.ones(200))
    ahead = [s for s, _ in shadow_map.sides(PointLight("lamp", _CENTRE), _CENTRE + [[1.0, 0.2, 0.3]])]
    assert len(ahead) == 1


@pytest.mark.parametrize("axis", [0, 1, 2])
@pytest.mark.parametrize("sign", [-1.0, 1.0])
def test_texels_hold_the_depth_that_a_camera_sees(axis: int, sign: float, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(shadow_map, "_SLOPE", 0.0)
    forward = np.zeros(3)
    forward[axis] = sign
    point = _CENTRE + forward
    ((side, _),) = shadow_map.sides(PointLight("lamp", _CENTRE), point[None])
    texels = shadow_map.NumpyRasteriser(*_mesh()).draw(side, _SIZE)
    # The camera of this side: its x and y are those of the map, or the mirrored ones; then the picture is mirrored.
    pose = look_at(_CENTRE, point, np.eye(3)[(axis + 1) % 3])
    camera = Camera(_SIZE, _SIZE, _SIZE / 2, _SIZE / 2, _SIZE / 2 - 0.5, _SIZE / 2 - 0.5, pose)
    scene = Scene()
    scene.put("mesh", *_mesh())
    depth, _ = render_depth(scene, camera, "cpu")
    x, y = (side.matrix[:2, :3] @ pose[:3, k] for k in range(2))
    seen = depth if abs(x[0]) > 0.5 else depth.T
    x_sign, y_sign = (x[0], y[1]) if abs(x[0]) > 0.5 else (y[0], x[1])
    seen = seen[:: int(round(y_sign)), :: int(round(x_sign))]
    expected = np.where(np.isfinite(seen), 1.0 / seen, 0.0)
    same = np.abs(texels - expected) <= 1e-5 * np.abs(expected)
    assert same.mean() > 0.999  # an edge through a texel's centre may fall to either side


@pytest.mark.parametrize("light", [PointLight("lamp", _CENTRE), _SUN], ids=["lamp", "sun"])
def test_opengl_draws_the_same(light: PointLight | DirectionalLight) -> None:
    drawers = (shadow_map.NumpyRasteriser(*_mesh()), _gl())
    for side, _ in shadow_map.sides(light, _AROUND):
        ours, theirs = (drawer.draw(side, _SIZE) for drawer in drawers)
        with np.errstate(invalid="ignore"):
            same = (np.abs(ours - theirs) <= 1e-3 * np.abs(ours)) | (ours == theirs)
        # Beside an edge OpenGL takes the change of q from texels that another triangle covers.
        assert same.mean() > 0.97
    assert drawers[1].seconds([side], _SIZE) > 0.0


def test_a_plate_shades_what_is_behind_it() -> None:
    plate = np.array([(-1.0, -1.0, 2.0), (1.0, -1.0, 2.0), (1.0, 1.0, 2.0), (-1.0, 1.0, 2.0)])
    drawer = shadow_map.NumpyRasteriser(plate, np.array([(0, 1, 2), (0, 2, 3)]))
    points = np.array([(0.1, 0.2, 4.0), (0.1, 0.2, 1.0), (3.5, 0.2, 4.0), (0.1, 0.2, -4.0)])
    for light in (PointLight("lamp", (0.0, 0.0, 0.0)), DirectionalLight("sun", (0.0, 0.0, 1.0))):
        found = shadow_map.masks(drawer, light, points, 1e-3, 64)
        for factor in shadow_map.BIASES:
            assert found[factor].tolist() == [True, False, False, False]


@pytest.mark.parametrize("light", [PointLight("lamp", (0.0, 0.0, 0.0)), DirectionalLight("sun", (0.0, 0.0, 1.0))])
def test_no_plane_shades_itself(light: PointLight | DirectionalLight, monkeypatch: pytest.MonkeyPatch) -> None:
    slope = np.array([(-3.0, -3.0, 1.5), (3.0, -3.0, 4.0), (3.0, 3.0, 9.0), (-3.0, 3.0, 6.5)])
    drawer = shadow_map.NumpyRasteriser(slope, np.array([(0, 1, 2), (0, 2, 3)]))
    at = np.random.default_rng(1).uniform(0.1, 0.9, (500, 2))
    points = slope[0] + at[:, :1] * (slope[1] - slope[0]) + at[:, 1:] * (slope[3] - slope[0])
    assert not shadow_map.masks(drawer, light, points, 1e-6, 32)[1.0].any()
    monkeypatch.setattr(shadow_map, "_SLOPE", 0.0)
    assert shadow_map.masks(drawer, light, points, 1e-6, 32)[1.0].mean() > 0.2


def test_the_stand_in_has_no_time() -> None:
    with pytest.raises(NotImplementedError):
        shadow_map.NumpyRasteriser(*_mesh()).seconds([], 4)
