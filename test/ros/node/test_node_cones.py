# SPDX-License-Identifier: Apache-2.0
"""Cones that a query asks about: what is certain of them is what the library says."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
from harness import Rig, plate, wall
from node_world import UNKNOWN, cloud_msg, library_with_plate
from sensor_msgs.msg import PointCloud2, PointField

from shadow_tracer import DirectionalLight, Outcome, PointLight, ShadowTracer, SpotLight
from shadow_tracer.ros.diagnostics import ERROR, PROCESSING, WARN

_BIAS = 0.01
_LIGHTS = {
    "mask.unknown_value": UNKNOWN,
    "bias.constant": _BIAS,
    "light_names": ["lamp", "spot", "off", "sky"],
    "lights.lamp.range": 0.5,
    "lights.spot.type": "spot",
    "lights.spot.outer_angle": 0.3,
    "lights.off.enabled": False,
    "lights.sky.type": "directional",
}
_PLACE, _WAY = np.array([0.5, -0.5, 0.0]), np.array([0.0, 0.0, 1.0])
_ENABLED: dict[int, Any] = {
    0: PointLight("lamp", _PLACE, range=0.5),
    1: SpotLight("spot", _PLACE, _WAY, 0.3),
    3: DirectionalLight("sky", _WAY),
}


@pytest.fixture
def rig() -> Iterator[Rig]:
    with Rig(_LIGHTS) as made:
        made.send_mesh(*plate())
        yield made


@pytest.fixture(scope="module")
def tracer() -> ShadowTracer:
    return library_with_plate()


def _points(count: int, seed: int = 1) -> np.ndarray:
    points = np.random.default_rng(seed).uniform((-1.0, -1.0, 0.2), (1.0, 1.0, 2.5), (count, 3))
    return points.astype(np.float32).astype(np.float64)


def _query(points: np.ndarray, sizes: Any, name: str = "radius", kind: str = "f8") -> PointCloud2:
    """A cloud whose fourth field says how wide its cones are."""
    msg = cloud_msg(points, kind=kind)
    rows = np.frombuffer(msg.data, kind).reshape(-1, 4).copy()
    rows[:, 3] = sizes
    msg.data = rows.view(np.uint8).reshape(-1)
    msg.fields[3].name = name
    return msg


def _answer(msg: PointCloud2) -> np.ndarray:
    assert [field.name for field in msg.fields] == ["x", "y", "z", "lights", "known", "free", "blocked"]
    assert [field.offset for field in msg.fields] == [0, 4, 8, 12, 16, 20, 24] and msg.point_step == 28
    return np.frombuffer(msg.data, _ROWS)


_ROWS = np.dtype(
    {
        "names": ["x", "y", "z", "lights", "known", "free", "blocked"],
        "formats": ["<f4", "<f4", "<f4", "<u4", "u1", "<u4", "<u4"],
        "offsets": [0, 4, 8, 12, 16, 20, 24],
        "itemsize": 28,
    }
)


def _expected(tracer: ShadowTracer, points: np.ndarray, lights: dict[int, Any], **wide: Any) -> list[np.ndarray]:
    """Bits of free and of blocked cones, asked one by one."""
    found = [np.zeros(len(points), np.uint32) for _ in range(2)]
    for bit, light in lights.items():
        for number, point in enumerate(points):
            way = -_WAY if bit == 3 else (light.position - point) / np.linalg.norm(light.position - point)
            one = {name: sizes[number] for name, sizes in wide.items()}
            outcome = tracer.cones(point + _BIAS * way, light, **one)
            found[0][number] |= np.uint32(outcome == Outcome.FREE) << np.uint32(bit)
            found[1][number] |= np.uint32(outcome == Outcome.BLOCKED) << np.uint32(bit)
    return found


@pytest.mark.parametrize("name", ["radius", "half_angle"])
def test_answers_are_those_of_the_library(rig: Rig, tracer: ShadowTracer, name: str) -> None:
    """To each light of the list; where a light shines, and how far, does not matter to them."""
    points = _points(150)
    sizes = np.random.default_rng(2).uniform(0.002, 0.06, 150).astype(np.float32).astype(np.float64)
    lights = {bit: light for bit, light in _ENABLED.items() if name == "half_angle" or bit != 3}
    free, blocked = _expected(tracer, points, lights, **{name: sizes})
    assert all(((bits >> bit & 1).sum() > 2) for bits in (free, blocked) for bit in lights)
    plain = np.frombuffer(rig.ask(cloud_msg(points)).data, np.uint8).reshape(150, 20)[:, 12:16].copy().view("<u4")[:, 0]
    for kind in ("f8", "f4"):
        rows = _answer(rig.ask(_query(points, sizes, name, kind)))
        assert rows["known"].all()
        np.testing.assert_array_equal(rows["free"], free)
        np.testing.assert_array_equal(rows["blocked"], blocked)
        np.testing.assert_array_equal(rows["lights"], plain)  # as without cones
    assert rig.value(PROCESSING, "faults") == "0"


def test_what_loads_is_loaded_beside_the_node(rig: Rig) -> None:
    """Once; frames that come meanwhile are traced afterwards, and queries of either kind are answered in order."""
    assert not rig.core.host.ready_for_cones
    rig.ask(cloud_msg(_points(3)))
    assert not rig.core.host.ready_for_cones
    jobs, submit = [], rig.core.host._submit
    rig.core.host._submit = lambda job: (jobs.append(job.name), submit(job))[1]  # type: ignore[method-assign]
    answers = rig.collect(PointCloud2, "shadow_tracer/query/visibility")
    before, publisher = len(answers), rig.publisher(PointCloud2, "query")
    for number in range(4):
        publisher.publish(cloud_msg(_points(3 + number)) if number % 2 else _query(_points(3 + number), 0.1))
    rig.until(lambda: len(answers) == before + 4)
    assert [msg.width for msg in answers[before:]] == [3, 4, 5, 6]
    assert [len(msg.fields) for msg in answers[before:]] == [7, 5, 7, 5]
    assert jobs == ["cones"] and rig.core.host.ready_for_cones
    assert (rig.trace(wall()) != UNKNOWN).any()
    rig.wait_status("device", b"\x00", "on cpu")


def test_kernels_that_do_not_load_are_not_loaded_again(rig: Rig, monkeypatch: pytest.MonkeyPatch) -> None:
    def broken(*_: Any, **__: Any) -> None:
        raise RuntimeError("no compiler")

    made = rig.core.host.made
    monkeypatch.setattr(made, "warm_up", broken)
    monkeypatch.setattr(made, "cones", broken)
    rows = _answer(rig.ask(_query(_points(5), 0.1)))
    assert not rows["known"].any() and not rows["free"].any()
    rig.wait_status(PROCESSING, ERROR, "the query failed: no compiler")
    monkeypatch.undo()
    assert _answer(rig.ask(_query(_points(5), 0.1)))["known"].all()


def test_cones_that_there_are_not_have_neither_bit(rig: Rig) -> None:
    """From the light, from no farther than the bias, too wide, and from beyond any scene; the rest of the row is known.
    A row without a number is not known."""
    points = np.array(
        [_PLACE, _PLACE + (0, 0, 0.005), _PLACE + (0, 0, 0.1), (0.6, 0.6, 0.5), (0.6, 0.6, 0.5), (0, 0, 1e60)]
    )
    rows = _answer(rig.ask(_query(points, [0.1, 0.1, 5.0, 0.1, np.nan, 0.1])))
    assert rows["known"].tolist()[:5] == [1, 1, 1, 1, 0]
    assert rows["free"].tolist() == [0, 0, 0, 3, 0, 0] and not rows["blocked"].any()
    rows = _answer(rig.ask(_query(points[:5], [0.1, 0.1, 1.5, 0.1, np.inf], "half_angle")))
    assert rows["known"].tolist() == [1, 1, 1, 1, 0] and rows["free"].tolist()[3] == 11


def test_a_light_does_not_meet_what_it_ignores(rig: Rig) -> None:
    behind = np.array([[0.0, 0.0, 2.0]])
    blocked = _answer(rig.ask(_query(behind, 0.01, "half_angle")))["blocked"][0]
    assert blocked & 8
    assert rig.set(lights__sky__ignore=["mesh"]) == ""
    rows = _answer(rig.ask(_query(behind, 0.01, "half_angle")))
    assert rows["free"][0] & 8 and rows["blocked"][0] == blocked & ~np.uint32(8)


def test_fields_that_are_wrong_are_refused_by_name(rig: Rig) -> None:
    publisher = rig.publisher(PointCloud2, "query")
    answers = rig.collect(PointCloud2, "shadow_tracer/query/visibility")
    points = _points(4)
    both = _query(points, 0.1, kind="f4")
    both.fields.append(PointField(name="half_angle", offset=12, datatype=PointField.FLOAT32, count=1))
    twice = _query(points, 0.1, kind="f4")
    twice.fields.append(PointField(name="radius", offset=12, datatype=PointField.FLOAT32, count=1))
    whole = _query(points, 0.1, kind="f4")
    whole.fields[3].datatype = PointField.INT32
    bad = [
        (both, "fields: expected radius or half_angle, got both"),
        (twice, "fields: expected one radius, got"),
        (whole, "fields: expected radius of datatype 7"),
        (_query(points, [0.1, 0.1, -0.5, 0.1]), "data: expected radius from 0 to 1e+50, got -0.5 for point 2"),
        (_query(points, 1.6, "half_angle"), "data: expected half_angle from 0 to 1.5, got 1.6 for point 0"),
    ]
    for number, (message, text) in enumerate(bad, 1):
        publisher.publish(message)
        rig.until(lambda count=str(number): rig.value(PROCESSING, "queries refused") == count)
        rig.wait_status(PROCESSING, WARN, f"query refused, {text}")
    assert not answers and not rig.core.host.ready_for_cones
    assert _answer(rig.ask(_query(points, 0.1)))["known"].all()
    assert len(_answer(rig.ask(_query(np.empty((0, 3)), 0.1)))) == 0
