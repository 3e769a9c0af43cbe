# SPDX-License-Identifier: Apache-2.0
"""A bag that is played in windows gives the bytes of one that is played at once, whatever is in force at a cut."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from bag_journey import DEPTH, FOCAL, INFO, MARKER, MESH, SECOND, corners, log_of
from bag_maker import BagMaker, cloud, image, info, pose, transform
from bags_runs import PARAMETERS, WISH, play_windows, uncut

from shadow_tracer.apps.bag.survey import Survey
from shadow_tracer.apps.bags.jobs import Options
from shadow_tracer.apps.bags.plan import Cut, make
from shadow_tracer.ros.wire.cdr import encode_mesh
from shadow_tracer.ros.wire.cdr_markers import MarkerMessage, encode_marker
from shadow_tracer.ros.wire.grid_map import GRID_MAP, GridMap, encode_grid_map

W, H = 10, 8
FRAMES = 40
SHIFT = (0.0, -0.3, 0.0)


def _depth(k: int) -> np.ndarray:
    return np.random.default_rng(k).integers(1900, 2100, (H, W)).astype(np.uint16)


def _marker(made: BagMaker, k: int, action: int = 0, lifetime: int = 0, number: int = 0, frame: str = "odom") -> None:
    points = corners(0.6 - 0.015 * k) + SHIFT + (0.0, 0.1 * number, 0.1)
    content = points if action == 0 else np.zeros((0, 3))
    stamp = 100 * SECOND + k * SECOND // 8
    made.raw("/mesh_marker", MARKER, encode_marker(
        MarkerMessage(ns="m", id=number, frame=frame, stamp=stamp, action=action, points=content, lifetime=lifetime)
    ))  # fmt: skip


def busy(frames: int = FRAMES) -> BagMaker:
    """Markers that are added, deleted and run out, a mesh now and then, one that is refused, lights that move,
    camera_info before, behind and without its image, images that nobody can read, and stamps that start again."""
    made = BagMaker()
    made.add("/tf_static", transform("base", "camera", 0, (0.0, 0.125, 0.0)))
    made.add("/tf", transform("odom", "base", 0, (-0.5, 0.0, 0.0)))
    made.add("/tf", transform("odom", "base", 200 * SECOND, (0.5, 0.0, 0.0)))
    for k in range(frames):
        stamp = 100 * SECOND + (k % 29) * SECOND // 8
        if k % 7 == 2:
            made.raw("/mesh", MESH, encode_mesh(corners(0.015 * k) + SHIFT, [(0, 1, 2)]))
        if k % 11 == 5:
            made.raw("/mesh", MESH, b"\0\1\0\0nothing")
        if k % 4 == 1:
            _marker(made, k, number=k % 3, lifetime=5_000_000 * (k % 3))
        if k % 9 == 4:
            _marker(made, k, action=2, number=k % 3)
        if k % 5 == 3:
            made.add("/mesh_cloud", cloud(np.float32(corners(0.3 + 0.01 * k) + SHIFT), stamp, "odom"))
        if k % 6 == 1:
            made.add("/shadow_tracer/lights/spot/pose", pose(stamp, "camera", (0.01 * k, 0.0, 0.0), (0, -0.6, 0, 0.8)))
        if k == 17:
            made.add("/tf_static", transform("base", "camera", 0, (0.0, -0.125, 0.0)))
        late = k % 8 == 6
        if k % 10 != 9 and not late:
            made.add(INFO, info(W, H, stamp, FOCAL / 4 + k % 2))
        if k % 13 == 8:
            broken = image(_depth(k), stamp)
            broken.encoding = "nonsense"
            made.add(DEPTH, broken)
        else:
            made.add(DEPTH, image(_depth(k), stamp))
        if late:
            made.add(INFO, info(W, H, stamp, FOCAL / 4 + k % 2))
    return made


@pytest.mark.slow
@pytest.mark.parametrize("policy", ["auto", "latest"])
def test_windows_give_the_bytes_of_one_run(tmp_path: Path, policy: str) -> None:
    bag = busy().write(tmp_path / "bag")
    parameters = PARAMETERS | {"camera_info_policy": policy}
    expected = log_of(uncut(bag, tmp_path / "whole.mcap", parameters))
    masks = [data for topic, _, data in expected if "/mask/lamp" in topic]
    assert len(masks) == FRAMES - 3 and len({data[-W * H :] for data in masks}) > 20
    for frames in (FRAMES, 6, 1):
        found, reports = play_windows(bag, tmp_path / f"by{frames}", parameters, frames)
        assert len(reports) == -(-FRAMES // frames)
        assert found == expected
        assert sum(report.refused.get("mesh", [0])[0] for report in reports) == 4
        assert sum(report.refused.get("depth", [0])[0] for report in reports) == 3
        assert sum(report.passes - 1 for report in reports) == 1


@pytest.mark.slow
def test_a_survey_comes_back_from_its_file(tmp_path: Path) -> None:
    bag = busy(12).write(tmp_path / "bag")
    play_windows(bag, tmp_path / "out", PARAMETERS, 100)
    made = Survey.load(tmp_path / "out" / ".plan" / "bag.npz")
    again = tmp_path / "again.npz"
    made.save(again)
    other = Survey.load(again)
    assert (other.frames == made.frames).all() and other.logged == made.logged and other.meshes == made.meshes
    for name, rows in made.transforms.rows().items():
        assert (other.transforms.rows()[name] == rows).all()


def _surveyed(made: BagMaker, path: Path, parameters: dict[str, Any] | None = None) -> list[str]:
    options = Options("/shadow_tracer", [], PARAMETERS | (parameters or {}), "", WISH, 1)
    (entry,) = make([made.write(path / "bag")], path / "out", options, Cut(5), None, False).entries
    assert not entry.error and len(entry.windows) == (1 if entry.notes else 2)
    return entry.notes


def test_what_depends_on_earlier_images_is_not_cut(tmp_path: Path) -> None:
    def made(frame: str = "odom", stamped: bool = True, moved: bool = False) -> BagMaker:
        log = BagMaker()
        log.add("/tf_static", transform("odom", "camera", 0, (0.0, 0.0, 0.0)))
        if stamped:
            _marker(log, 0, frame=frame)
        else:
            log.raw("/mesh_marker", MARKER, encode_marker(MarkerMessage(frame=frame, points=corners(0.0))))
        for k in range(10):
            log.add(INFO, info(W, H, (100 + k) * SECOND, FOCAL / 4))
            log.add(DEPTH, image(_depth(k), (100 + k) * SECOND))
        if moved:
            log.add("/tf_static", transform("odom", "camera", 0, (1.0, 0.0, 0.0)))
        return log

    cases = [made(), made("camera"), made("odom", False, True), made("camera", False), made("camera", moved=True)]
    found = [_surveyed(log, tmp_path / str(number)) for number, log in enumerate(cases)]
    assert found[:3] == [[], [], []]
    assert "without stamp" in found[3][0] and "static transforms change" in found[4][0]
    assert "dose.parts" in _surveyed(made(), tmp_path / "dose", {"dose.parts": ["m/0"]})[0]


@pytest.mark.slow
def test_meshes_that_fit_only_together_with_what_has_gone(tmp_path: Path) -> None:
    log = BagMaker()
    log.add("/tf_static", transform("odom", "camera", 0, (0.0, 0.0, 0.0)))
    for k in range(8):
        # of 64 triangles 40 fit beside the mesh, and 60 do not: the mesh that stays is an earlier one or none
        count = (40, 60, 60, 10, 62, 1, 64, 30)[k]
        log.raw("/mesh", MESH, encode_mesh(corners(0.05 * k) + SHIFT, [(0, 1, 2)] * count))
        points = np.concatenate([corners(0.1 * k) + SHIFT] * (20, 3, 30, 5)[k % 4])
        log.raw("/mesh_marker", MARKER, encode_marker(MarkerMessage(ns="m", id=k % 3, frame="odom", points=points)))
        log.add(INFO, info(W, H, (100 + k) * SECOND, FOCAL / 4))
        log.add(DEPTH, image(_depth(k), (100 + k) * SECOND))
    bag, parameters = log.write(tmp_path / "bag"), PARAMETERS | {"bounds.max_triangles": 64}
    expected = log_of(uncut(bag, tmp_path / "whole.mcap", parameters))
    found, reports = play_windows(bag, tmp_path / "out", parameters, 1)
    assert found == expected
    assert sum(count for report in reports for count, _ in report.refused.values()) > 2


@pytest.mark.slow
def test_the_ground_is_sent_when_it_would_be(tmp_path: Path) -> None:
    """Grids come some time after the last one, which may stand in an earlier window."""
    values = np.zeros((4, 5), np.float32)
    log = BagMaker()
    log.add("/tf_static", transform("odom", "camera", 0, (0.0, 0.0, 0.0)))
    for k in range(12):
        log.now += 350_000_000
        values[1, 2] = 0.1 * k
        if k in (2, 3, 7):
            ground = GridMap("odom", (100 + k) * SECOND, 0.5, (0.0, 0.0), values)
            log.raw("/grid_map", GRID_MAP, encode_grid_map(ground, {"elevation": values}))
        log.add(INFO, info(W, H, (100 + k) * SECOND, FOCAL / 4))
        log.add(DEPTH, image(_depth(k), (100 + k) * SECOND))
    bag = log.write(tmp_path / "bag")
    expected = log_of(uncut(bag, tmp_path / "whole.mcap", PARAMETERS))
    assert 2 < sum(topic.endswith("shadow_grid") for topic, _, _ in expected) < 10
    for frames in (1, 5):
        assert play_windows(bag, tmp_path / f"by{frames}", PARAMETERS, frames)[0] == expected
