# SPDX-License-Identifier: Apache-2.0
"""Markers of doses: a viewer that gets every message shows the maps as they are, and no more is sent than that."""

from __future__ import annotations

import geometry
import numpy as np
import pytest

from shadow_tracer import DoseMap, PointLight, ShadowTracer, Strength
from shadow_tracer.ros.wire.cdr_markers import ADD, DELETEALL, MarkerMessage
from shadow_tracer.ros.wire.dose_messages import CHUNK, DoseMarkers, cloud_rows
from shadow_tracer.scene.dose_colors import colors_of

LAMP = PointLight("lamp", (0.2, 0.1, 1.0), strength=Strength(power=10.0))
TARGET = 5.0
Seen = dict[tuple[str, int], MarkerMessage]


@pytest.fixture
def world(reference: ShadowTracer) -> ShadowTracer:
    reference.scene.put("floor", *geometry.square(2, 0.0, 1.0))
    return reference


def look(seen: Seen, message: list[MarkerMessage]) -> Seen:
    """What a viewer shows afterwards."""
    for marker in message:
        if marker.action == DELETEALL:
            seen = {}
        else:
            assert marker.action == ADD
            seen = {**seen, (marker.ns, marker.id): marker}
    return seen


def check(seen: Seen, shown: dict[str, DoseMap], frame: str = "map") -> None:
    """That it is the maps."""
    assert {ns for ns, _ in seen} == {f"dose/{part}" for part in shown}
    for part, dose_map in shown.items():
        markers = [marker for (ns, _), marker in sorted(seen.items()) if ns == f"dose/{part}"]
        pose = dose_map.pose()
        corners = dose_map.corners.reshape(-1, 3) @ pose[:3, :3].T + pose[:3, 3]
        points = np.concatenate([marker.points for marker in markers])
        np.testing.assert_allclose(points, corners, rtol=0.0, atol=1e-12)
        colors = np.concatenate([marker.colors for marker in markers])[::3, :3]
        assert np.array_equal(np.rint(255.0 * colors), colors_of(dose_map.dose, TARGET))
        assert {marker.frame for marker in markers} == {frame}


def test_what_is_new_is_sent_and_what_has_gone_is_taken_away(world: ShadowTracer) -> None:
    drawn, seen = DoseMarkers(), Seen()
    large = DoseMap(world, "floor", 0.016)
    assert len(large) > 2 * CHUNK
    shown = {"floor": large}
    seen = look(seen, first := drawn.message(shown, TARGET, "map"))
    check(seen, shown)
    assert first[0].action == DELETEALL and len(first) > 3 and drawn.message(shown, TARGET, "map") == []
    large.add([LAMP], 1.0)
    seen = look(seen, drawn.message(shown, TARGET, "map"))
    check(seen, shown)
    turned = np.diag([-1.0, -1.0, 1.0, 1.0])
    for change in ("pose", "frame", "everything"):
        if change == "pose":
            world.scene.move("floor", turned)
        frame = "map" if change == "pose" else "odom"
        message = drawn.message(shown, TARGET, frame, everything=change == "everything")
        assert len(message) == len(first) - (change != "everything"), change
        seen = look(seen, message)
        check(seen, shown, frame)
    small = {"floor": DoseMap(world, "floor", 0.5)}
    seen = look(seen, drawn.message(small, TARGET, "odom"))
    check(seen, small, "odom")
    assert drawn.message(small, TARGET, "odom") == []
    world.scene.put("wall", *geometry.square(2, 1.0, 1.0))
    for shown in ({**small, "wall": DoseMap(world, "wall", 0.5)}, small, {}, {}, small):
        seen = look(seen, drawn.message(shown, TARGET, "odom"))
        check(seen, shown, "odom")
    assert drawn.message({}, TARGET, "odom", everything=True)[0].action == DELETEALL
    assert drawn.message({}, TARGET, "odom", everything=True) == [], "there is nothing to take away"


def test_only_the_texels_whose_colours_change_are_sent(world: ShadowTracer) -> None:
    drawn, dose_map = DoseMarkers(), DoseMap(world, "floor", 0.016, side="both")
    shown = {"floor": dose_map}
    drawn.message(shown, TARGET, "map")
    dose_map.add([LAMP], 1.0)  # nothing arrives on the backs, the second half of all
    message = drawn.message(shown, TARGET, "map")
    assert [marker.id for marker in message] == list(range(-(-len(dose_map) // 2 // CHUNK)))


def test_rows_of_no_map_and_of_two(world: ShadowTracer) -> None:
    assert cloud_rows({}, TARGET).shape == (0,) and cloud_rows({}, TARGET).itemsize == 24
    world.scene.put("wall", *geometry.square(2, 0.5, 0.5))
    two = {part: DoseMap(world, part, 0.5) for part in ("floor", "wall")}
    rows = cloud_rows(two, TARGET)
    assert len(rows) == sum(map(len, two.values())) and rows.itemsize == 24
    assert np.array_equal(rows["z"], np.concatenate([each.positions()[:, 2] for each in two.values()]).astype("f4"))
