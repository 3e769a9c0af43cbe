# SPDX-License-Identifier: Apache-2.0
"""Shading, contact sheet, animation and table: right size, right content."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from shadow_tracer import Camera, DirectionalLight, PointLight, SpotLight
from shadow_tracer.apps.demo import stage_times
from shadow_tracer.apps.demo.lighting import StageLight
from shadow_tracer.apps.demo.shading import Surface

pytest.importorskip("PIL")
from PIL import Image

from shadow_tracer.apps.demo import pictures

W, H = 64, 48
LAMP = StageLight(PointLight("lamp", [0, 0, 0]), (1.0, 0.6, 0.3), 8.0)
SPOT = StageLight(SpotLight("spot", [0, 0, 0], [0, 0, 1], 0.2), (0.4, 0.7, 1.0), 8.0)
SUN = StageLight(DirectionalLight("sun", [0, 0, 1]), (1.0, 0.9, 0.8), 1.5)
LIGHTS = (LAMP, SPOT, SUN)


@pytest.fixture
def camera() -> Camera:
    return Camera(W, H, 60, 60, (W - 1) / 2, (H - 1) / 2)


@pytest.fixture
def depth() -> np.ndarray:
    wall = np.full((H, W), 2, dtype=np.float32)
    wall[:, :4] = np.nan
    return wall


@pytest.fixture
def masks() -> dict[str, np.ndarray]:
    left = np.zeros((H, W), dtype=np.uint8)
    left[:, : W // 2] = 255
    left[:, :4] = 100
    return {"lamp": left, "spot": left, "sun": left}


def surface(depth: np.ndarray, camera: Camera, smooth: int = 0) -> Surface:
    return Surface(depth, np.full((H, W, 3), 128, np.uint8), camera, (0, 1, 0), smooth)


@pytest.mark.parametrize("smooth", [0, 2])
def test_normals_of_a_wall_face_the_camera(depth: np.ndarray, camera: Camera, smooth: int) -> None:
    normals = surface(depth, camera, smooth).normals[:, 12:]
    assert np.abs(normals - [0, 0, -1]).max() < 1e-3


@pytest.mark.parametrize("light", LIGHTS, ids=lambda light: light.name)
def test_only_what_the_mask_says_is_lit(
    light: StageLight, depth: np.ndarray, camera: Camera, masks: dict[str, np.ndarray]
) -> None:
    scene = surface(depth, camera)
    dark = scene.lit([], masks)
    lit = scene.lit([light], masks)
    in_shadow = masks[light.name] != 255
    assert np.array_equal(lit[in_shadow], dark[in_shadow])
    middle = np.s_[H // 2, W // 2 - 2]
    assert (lit[middle].astype(int) > dark[middle]).all()


def test_light_of_a_spot_ends_at_its_cone(depth: np.ndarray, camera: Camera) -> None:
    scene = surface(depth, camera)
    amount = SPOT.radiance(scene.points, scene.normals, 1.0).sum(axis=-1)
    angle = np.arctan2(np.hypot(scene.points[..., 0], scene.points[..., 1]), scene.points[..., 2])
    assert (amount[(angle > 0.2) & scene.valid] == 0).all()
    assert (amount[(angle < 0.19) & scene.valid] > 0).all()


def test_strength_of_a_lamp_falls_with_the_square(camera: Camera) -> None:
    near, far = (surface(np.full((H, W), z, np.float32), camera) for z in (2, 4))
    middle = np.s_[H // 2, W // 2]
    one = LAMP.radiance(near.points, near.normals, 1.0)[middle]
    two = LAMP.radiance(far.points, far.normals, 1.0)[middle]
    assert one / two == pytest.approx(np.full(3, (16 + 0.15) / (4 + 0.15)), rel=1e-2)


def test_mask_picture_has_three_plain_colours(masks: dict[str, np.ndarray]) -> None:
    picture = pictures.mask_picture(masks["lamp"], LAMP)
    assert picture.shape == (H, W, 3)
    assert tuple(picture[0, 0]) == pictures.UNKNOWN
    assert tuple(picture[0, -1]) == pictures.SHADOW
    assert picture[0, 10].tolist() == sorted(picture[0, 10].tolist(), reverse=True)  # a warm colour
    assert picture[0, 10].max() > 200


def test_depth_picture_is_lighter_in_front(camera: Camera) -> None:
    slope = np.tile(np.linspace(1, 5, W, dtype=np.float32), (H, 1))
    slope[0, 0] = np.nan
    picture = pictures.depth_picture(slope)
    assert tuple(picture[0, 0]) == pictures.UNKNOWN
    assert (np.diff(picture[5].sum(axis=-1).astype(int)) <= 0).all()
    assert tuple(pictures.depth_picture(np.full((H, W), np.nan, np.float32))[3, 3]) == pictures.UNKNOWN


def test_reach_picture_adds_colours(depth: np.ndarray, masks: dict[str, np.ndarray]) -> None:
    masks["sun"] = np.zeros((H, W), np.uint8)
    picture = pictures.reach_picture(masks, LIGHTS, np.isfinite(depth))
    assert tuple(picture[0, 0]) == pictures.UNKNOWN
    assert tuple(picture[0, -1]) == pictures.SHADOW
    assert picture[0, 10].sum() > 2 * sum(pictures.SHADOW)


def test_contact_sheet_shows_everything(depth: np.ndarray, camera: Camera, masks: dict[str, np.ndarray]) -> None:
    scene = surface(depth, camera)
    whole = scene.lit(LIGHTS, masks)
    single = {light.name: scene.lit([light], masks) for light in LIGHTS}
    sheet = pictures.contact_sheet("title", "subtitle", whole, depth, masks, single, LIGHTS)
    pixels = np.asarray(sheet)
    w, h = pictures.TILE
    assert pixels.shape[1] == 3 * w + 4 * pictures.GAP
    # every tile of the three columns and four rows holds a picture, not background
    tops = [pictures.HEADER + k * (h + pictures.CAPTION + pictures.GAP) for k in range(4)]
    for top in tops:
        for column in range(3):
            left = pictures.GAP + column * (w + pictures.GAP)
            tile = pixels[top + 20 : top + h - 20, left + 20 : left + w - 20]
            assert (tile != pictures.BACKGROUND).any(axis=-1).mean() > 0.9
    assert (pixels[: pictures.HEADER] != pictures.BACKGROUND).any()


def test_animation_is_an_endless_gif_of_all_frames(
    tmp_path: Path, depth: np.ndarray, camera: Camera, masks: dict[str, np.ndarray]
) -> None:
    overlay = surface(depth, camera).lit(LIGHTS, masks)
    frames = []
    for k in range(5):
        moved = {name: np.roll(mask, 5 * k, axis=1) for name, mask in masks.items()}
        frames.append(pictures.panel(overlay, moved, LIGHTS, 120))
    pictures.save_animation(frames, tmp_path / "a.gif", [0.08] * 4 + [0.16])
    with Image.open(tmp_path / "a.gif") as gif:
        assert gif.n_frames == 5
        assert gif.size == frames[0].size == (160 + 2 + 53, 120)
        assert gif.info["duration"] == 80
        assert gif.info["loop"] == 0
        for k, frame in enumerate(frames):
            gif.seek(k)
            error = np.abs(np.asarray(gif.convert("RGB"), float) - np.asarray(frame, float))
            assert error.mean() < 4
            assert gif.info["duration"] == (160 if k == 4 else 80)


def test_animation_without_frames_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="frames: must hold at least one"):
        pictures.save_animation([], tmp_path / "a.gif", [])


def test_stage_times(tmp_path: Path) -> None:
    frames = [{"trace": float(k), "publish": 1.0} for k in range(1, 101)] + [{"trace": 50.5, "late": 3.0}]
    table = stage_times.rows(frames)
    assert [row.stage for row in table] == ["trace", "publish", "late"]
    assert table[0].median == 50.5
    assert table[0].p95 == pytest.approx(95, abs=0.2)
    text, data = stage_times.save(tmp_path, "workshop", {"device": "cpu"}, table)
    assert "| trace | 50.50 |" in text.read_text()
    assert json.loads(data.read_text())["stages"]["publish"] == {"median_ms": 1.0, "p95_ms": 1.0}
