# SPDX-License-Identifier: Apache-2.0
"""The demo scene: large enough, sound, in motion, and the same every time."""

from __future__ import annotations

import numpy as np
import pytest

from shadow_tracer import Camera, DirectionalLight, PointLight, SpotLight
from shadow_tracer.apps.demo import robot, workshop
from shadow_tracer.apps.demo.sequence import WorkshopSequence, workshop_lights


@pytest.fixture(scope="module")
def scene() -> workshop.Workshop:
    return workshop.Workshop()


def test_scene_is_large_and_sound(scene: workshop.Workshop) -> None:
    vertices = scene.vertices(0.3)
    assert len(scene.triangles) >= 30_000
    assert scene.triangles.dtype == np.int32
    assert scene.triangles.min() == 0
    assert scene.triangles.max() == len(vertices) - 1
    assert np.isfinite(vertices).all()
    assert scene.colours.shape == (len(scene.triangles), 3)
    assert scene.colours.min() >= 0
    assert scene.colours.max() <= 1.1
    assert 0 < scene.still_triangles < len(scene.triangles)


def test_every_frame_is_new_and_the_still_part_stays(scene: workshop.Workshop) -> None:
    phases = np.arange(8) / 8
    frames = [scene.vertices(p) for p in phases]
    still = scene.triangles[: scene.still_triangles].max() + 1
    for one, two in zip(frames, frames[1:], strict=False):
        assert np.array_equal(one[:still], two[:still])
        assert (np.abs(one[still:] - two[still:]).max(axis=1) > 1e-3).mean() > 0.9


def test_scene_repeats_and_is_deterministic(scene: workshop.Workshop) -> None:
    assert np.array_equal(workshop.Workshop().vertices(0.37), scene.vertices(0.37))
    moved = np.linalg.norm(scene.vertices(1.0) - scene.vertices(0.0), axis=1)
    # only the cartons have moved on, each into the place of the next
    assert np.unique(moved.round(6)).tolist() == [0.0, workshop.CARTON_STEP]


def test_links_of_the_robot_are_rigid() -> None:
    base = np.eye(4)
    for phase in (0.0, 0.21, 0.77):
        for pose in robot.forward_kinematics(base, robot.gesture(phase)):
            assert pose[:3, :3] @ pose[:3, :3].T == pytest.approx(np.eye(3), abs=1e-12)
            assert np.linalg.det(pose[:3, :3]) == pytest.approx(1)
    straight = robot.forward_kinematics(base, [0.0] * 6)
    reach = np.sum([offset for offset, _ in robot.JOINTS], axis=0)
    assert straight[-1][:3, 3] == pytest.approx(reach)


def test_wrong_number_of_joint_angles_is_refused() -> None:
    with pytest.raises(ValueError, match="angles: must hold 6"):
        robot.forward_kinematics(np.eye(4), [0.0] * 5)


def test_camera_pose_is_rigid_and_upright() -> None:
    for phase in np.arange(5) / 5:
        pose = workshop.camera_to_world(phase)
        camera = Camera(64, 48, 50, 50, 31.5, 23.5, pose)  # refuses what is not rigid
        assert camera.camera_to_world[2, 1] < -0.5  # y of the image points down
        assert abs(camera.camera_to_world[2, 0]) < 1e-12  # and x is level
        assert 0 < camera.position[2] < workshop.HEIGHT


def test_there_is_a_lamp_a_spotlight_and_the_sun() -> None:
    kinds = {light.name: type(light.light) for light in workshop_lights()}
    assert kinds == {"lamp": PointLight, "spotlight": SpotLight, "sun": DirectionalLight}


def test_views_are_deterministic_and_end_with_a_larger_still() -> None:
    sequence = WorkshopSequence(4, (64, 48))
    assert (len(sequence), sequence.animated, sequence.still) == (5, 4, 4)
    view, again = sequence.view(2), WorkshopSequence(4, (64, 48)).view(2)
    assert np.array_equal(view.depth, again.depth, equal_nan=True)
    assert np.array_equal(view.colour, again.colour)
    assert not np.array_equal(view.depth, sequence.view(3).depth)
    assert view.depth.dtype == np.float32
    assert view.depth.shape == (48, 64)
    valid = np.isfinite(view.depth)
    assert valid.mean() > 0.9
    assert not valid.all()  # the sky in the windows
    assert 0.5 < view.depth[valid].min() < view.depth[valid].max() < 15
    assert sequence.view(4).depth.shape == (96, 128)


def test_depth_lies_on_the_mesh() -> None:
    """Each sample lies in the plane of some triangle: the depth is along the optical axis, not along the ray."""
    from shadow_tracer.apps.demo.render import RayCaster

    sequence = WorkshopSequence(4, (64, 48))
    view = sequence.view(1)
    assert view.vertices is not None
    depth, ids = RayCaster(view.vertices, sequence.triangles).image(view.camera)
    hit = ids >= 0
    points = view.camera.unproject(np.where(hit, depth, 1))[hit]
    a, b, c = np.moveaxis(view.vertices[sequence.triangles[ids[hit]]], 1, 0)
    normal = np.cross(b - a, c - a)
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    off = np.abs(np.einsum("ni,ni->n", points - a, normal))
    assert off.max() < 1e-4


@pytest.mark.parametrize(
    ("frames", "size", "text"),
    [(0, (64, 48), "frames: must be 1 or more"), (3, (8, 8), "size: "), (3, (4000, 4000), "size: ")],
)
def test_wrong_options_are_refused(frames: int, size: tuple[int, int], text: str) -> None:
    with pytest.raises(ValueError, match=text):
        WorkshopSequence(frames, size)
