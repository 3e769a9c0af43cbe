# SPDX-License-Identifier: Apache-2.0
"""Transforms without ROS answer as tf2's do: same numbers, same refusals, in the same words."""

from __future__ import annotations

import re
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from tf_double import SECOND, BufferCore, ConnectivityException, TransformException, transform

from shadow_tracer.ros.diagnostics import Missing
from shadow_tracer.ros.parameters.parameters import settings_from
from shadow_tracer.ros.wire.messages import MessageError, rigid
from shadow_tracer.ros.world.frames import Frames
from shadow_tracer.ros.world.transform_tree import TransformTree

pytest.importorskip("scipy")

HALF = float(np.sqrt(0.5))
STILL = (0.0, 0.0, 0.0, 1.0)


class Both:
    """A tree and a double of tf2 that get the same transforms."""

    def __init__(self) -> None:
        self.tree = TransformTree()
        self.core = BufferCore()

    def add(self, child: str, parent: str, stamp: int, translation: Any, quaternion: Any, static: bool) -> None:
        self.tree.add(child, parent, stamp, translation, quaternion, static)
        setter = self.core.set_transform_static if static else self.core.set_transform
        setter(transform(parent, child, stamp, translation, quaternion), "")

    def compare(self, target: str, source: str, stamp: int) -> type[Exception] | None:
        """Both answer the same, or refuse in the same words; returns the refusal of tf2."""
        try:
            found = self.core.lookup_transform_core(target, source, SimpleNamespace(nanoseconds=stamp)).transform
        except TransformException as error:
            with pytest.raises(Missing, match=re.escape(str(error).rstrip(". "))) as refused:
                self.tree.lookup(target, source, stamp, "for a test")
            assert "for a test" in refused.value.text and not refused.value.wait
            return type(error)
        t, q = found.translation, found.rotation
        expected = rigid((t.x, t.y, t.z), (q.x, q.y, q.z, q.w), "")
        np.testing.assert_allclose(self.tree.lookup(target, source, stamp, "for a test"), expected, atol=1e-12)
        return None


@pytest.mark.parametrize("slash", ["", "/"])
def test_leading_slashes_lead_to_the_same_frames(slash: str) -> None:
    """tf of ROS 1 wrote them, and some drivers still do, in transforms or in headers."""
    for in_tf in ("", "/"):
        tree = TransformTree()
        tree.add(f"{in_tf}camera", f"{in_tf}map", SECOND, (1.0, 2.0, 3.0), STILL, True)
        tree.add(f"{in_tf}arm", f"{in_tf}map", SECOND, (4.0, 5.0, 6.0), STILL, True)
        frames = Frames(lambda tree=tree: tree)  # type: ignore[misc]
        poses = frames.at(settings_from({"fixed_frame": "map"}), f"{slash}camera", SECOND)
        assert poses.camera_frame == "camera"
        assert poses.camera_to_world[:3, 3].tolist() == [1.0, 2.0, 3.0]
        assert poses.frame_to_world(f"{slash}camera", "a")[:3, 3].tolist() == [1.0, 2.0, 3.0]
        assert poses.frame_to_world(f"{slash}arm", "a")[:3, 3].tolist() == [4.0, 5.0, 6.0]
        np.testing.assert_array_equal(poses.frame_to_world(f"{slash}map", "a"), np.eye(4))


def random_tree(rng: np.random.Generator) -> tuple[Both, list[str]]:
    both, names = Both(), ["map", "other"]
    for number in range(6):
        child, parent = f"frame{number}", names[int(rng.integers(len(names)))]
        static = bool(rng.random() < 0.3)
        stamps = rng.permutation(np.arange(1, 9))[: 1 if static else int(rng.integers(1, 6))] * SECOND
        for stamp in sorted(stamps.tolist()):
            quaternion = rng.normal(size=4)
            quaternion /= np.linalg.norm(quaternion)
            both.add(child, parent, stamp, tuple(rng.normal(size=3)), tuple(quaternion.tolist()), static)
        names.append(child)
    return both, names


@pytest.mark.parametrize("seed", range(12))
def test_a_tree_answers_as_tf2(seed: int) -> None:
    rng = np.random.default_rng(seed)
    both, names = random_tree(rng)
    outcomes = []
    for _ in range(150):
        target, source = rng.choice([*names, "nobody"], 2, replace=False)
        stamp = int(rng.integers(0, 20)) * SECOND // 2 + SECOND // 2
        outcomes.append(both.compare(str(target), str(source), stamp))
    assert None in outcomes and len(set(outcomes)) >= 3


def test_a_frame_that_changes_its_parent() -> None:
    both = Both()
    both.add("cup", "left", 1 * SECOND, (1.0, 0.0, 0.0), STILL, False)
    both.add("cup", "right", 3 * SECOND, (5.0, 0.0, 0.0), STILL, False)
    both.add("left", "map", 0, (0.0, 1.0, 0.0), STILL, True)
    both.add("right", "map", 0, (0.0, -1.0, 0.0), STILL, True)
    for stamp, place in ((1, (1, 1, 0)), (2, (1, 1, 0)), (3, (5, -1, 0))):
        assert both.compare("map", "cup", stamp * SECOND) is None
        np.testing.assert_array_equal(both.tree.lookup("map", "cup", stamp * SECOND, "")[:3, 3], place)


def test_slerp_takes_the_shorter_way() -> None:
    both = Both()
    both.add("arm", "map", SECOND, (0.0, 0.0, 0.0), STILL, False)
    both.add("arm", "map", 2 * SECOND, (0.0, 0.0, 0.0), (0.0, 0.0, -HALF, -HALF), False)
    assert both.compare("map", "arm", SECOND * 5 // 4) is None
    turned = both.tree.lookup("map", "arm", SECOND * 3 // 2, "")
    np.testing.assert_allclose(turned[:3, 0], (HALF, HALF, 0.0), atol=1e-15)


def test_loops_and_trees_apart() -> None:
    both = Both()
    both.add("a", "b", 0, (1.0, 0.0, 0.0), STILL, True)
    both.add("c", "d", 0, (1.0, 0.0, 0.0), STILL, True)
    assert both.compare("b", "d", SECOND) is ConnectivityException
    both.tree.add("b", "a", 0, (1.0, 0.0, 0.0), STILL, True)
    with pytest.raises(Missing, match="contains a loop"):
        both.tree.lookup("d", "a", SECOND, "")
    assert not both.tree.is_static("d", "a")


def test_what_is_static() -> None:
    tree = TransformTree()
    tree.add("base", "map", SECOND, (1.0, 0.0, 0.0), STILL, False)
    tree.add("camera", "base", 0, (0.0, 2.0, 0.0), STILL, True)
    tree.add("lamp", "base", 0, (0.0, 0.0, 3.0), STILL, True)
    assert tree.is_static("camera", "lamp") and tree.is_static("base", "lamp") and not tree.is_static("map", "lamp")
    assert tree.frames == ("base", "camera", "lamp", "map")
    np.testing.assert_array_equal(tree.lookup("lamp", "camera", 10**18, "")[:3, 3], (0, 2, -3))
    tree.clear()
    np.testing.assert_array_equal(tree.lookup("lamp", "camera", 10**18, "")[:3, 3], (0, 2, -3))
    with pytest.raises(Missing):
        tree.lookup("map", "lamp", SECOND, "")
    tree.add("lamp", "base", 0, (0.0, 0.0, 4.0), STILL, True)  # published anew
    np.testing.assert_array_equal(tree.lookup("base", "lamp", 5, "")[:3, 3], (0, 0, 4))
    tree.add("lamp", "base", SECOND, (0.0, 0.0, 5.0), STILL, False)  # from now on it moves
    assert not tree.is_static("base", "lamp")


@pytest.mark.parametrize(
    ("child", "parent", "translation", "quaternion", "message"),
    [
        ("a", "a", (0.0, 0.0, 0.0), STILL, "child_frame_id: expected two different frames, got 'a' in 'a'"),
        ("", "a", (0.0, 0.0, 0.0), STILL, "child_frame_id"),
        ("a", "/", (0.0, 0.0, 0.0), STILL, "child_frame_id"),
        ("a", "b", (0.0, float("nan"), 0.0), STILL, "transform from a to b: expected finite"),
        ("a", "b", (0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 0.0), "transform from a to b: expected a unit quaternion"),
    ],
)
def test_bad_transforms_are_refused(child: str, parent: str, translation: Any, quaternion: Any, message: str) -> None:
    tree = TransformTree()
    with pytest.raises(MessageError, match=message):
        tree.add(child, parent, 1, translation, quaternion, False)
    assert tree.frames == ()


def test_frames_use_it_in_place_of_tf() -> None:
    tree = TransformTree()
    tree.add("/camera", "/map", 0, (1.0, 0.0, 0.0), (0.0, 0.0, HALF, HALF), True)
    settings = settings_from({"fixed_frame": "map"})
    frames = Frames(lambda: tree, static_period=0.0)
    frames.configure(settings)
    np.testing.assert_allclose(frames.at(settings, "camera", 5).camera_to_world @ (1, 0, 0, 1), (1, 1, 0, 1))
    tree.add("camera", "map", 0, (2.0, 0.0, 0.0), STILL, True)
    assert frames.at(settings, "camera", 5).camera_to_world[0, 3] == 2.0  # nothing is kept with a period of 0
