# SPDX-License-Identifier: Apache-2.0
"""Parameters of a running node: what changes the mask at once, what is refused and why."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
from harness import Rig, plate, wall
from rclpy.parameter import Parameter

from shadow_tracer import available_pipelines
from shadow_tracer.ros.diagnostics import DEVICE, OK, PROCESSING
from shadow_tracer.ros.parameters import LIGHT_PARAMETERS, PARAMETERS, ParameterError, names_for


@pytest.fixture
def rig() -> Iterator[Rig]:
    with Rig({"pose_source": "parameter", "tf_timeout": 1.0}) as made:
        made.send_mesh(*plate())
        yield made


CHANGES: list[dict[str, Any]] = [
    {"camera_pose": [0.1, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0]},
    {"camera_pose": [1, 0, 0, 0, 0, 0, 1]},
    {"bias__constant": 1.5},
    {"bias__constant": 2},
    {"bias__quadratic": 0.5},
    {"mask__unknown_value": 99},
    {"lights__lamp__position": [0.2, 0.3, 0.0]},
    {"lights__lamp__type": "directional", "lights__lamp__direction": [0.0, 0.2, 1.0]},
    {"lights__lamp__type": "spot"},
    {"lights__lamp__type": "spot", "lights__lamp__outer_angle": 0.2},
    {"lights__lamp__type": "spot", "lights__lamp__direction": [-0.3, 0.0, 1.0]},
    {"lights__lamp__range": 2.1},
    {"lights__lamp__enabled": False, "mask__unknown_value": 3},
    {"lights": ["other", "lamp"], "mask__unknown_value": 5},
]


@pytest.mark.parametrize("change", CHANGES, ids=lambda change: ",".join(change))
def test_a_change_shows_in_the_next_mask(rig: Rig, change: dict[str, Any]) -> None:
    before = rig.trace(wall())
    assert rig.set(**change) == ""
    assert not np.array_equal(rig.trace(wall()), before)


@pytest.mark.parametrize(
    ("name", "value", "reason"),
    [
        ("device", "cpu", "device is read-only: buffers and kernels live on one device"),
        (
            "bounds__max_triangles",
            5,
            "bounds.max_triangles is read-only: device buffers of this size are allocated once",
        ),
        ("bounds__max_rays", 5, "bounds.max_rays is read-only"),
        ("bounds__max_lights", 5, "bounds.max_lights is read-only"),
        ("bounds__queue_capacity", 5, "bounds.queue_capacity is read-only"),
        ("bounds__grid_entries", 5, "bounds.grid_entries is read-only"),
        ("bias__constant", -1.0, "out of range"),
        ("bias__constant", math.nan, "out of range"),
        ("bias__constant", "small", "Wrong parameter type"),
        ("mask__unknown_value", 255, "out of range"),
        ("pose_source", "gps", "pose_source: expected string (tf, topic, parameter), got 'gps'"),
        ("variant", "float64", "variant: expected one of packed, packed_scalar"),
        ("camera_pose", [0.0], "camera_pose: expected double array (7 numbers)"),
        ("lights", ["a b"], "lights: expected names"),
        ("lights", ["a", "a"], "lights: expected different names"),
        ("lights__lamp__position", [0.0, math.inf, 0.0], "lights.lamp.position: expected double array (3 numbers m)"),
        ("lights__lamp__direction", [0.0, 0.0, 0.0], "lights.lamp.direction: expected a length"),
        ("lights__lamp__postion", [0.0, 0.0, 0.0], "did you mean lights.lamp.position?"),
        ("lights__sun__position", [0.0, 0.0, 0.0], "'sun' is not in lights ['lamp']"),
        ("bias__constnt", 1.0, "did you mean bias.constant?"),
    ],
)
def test_what_is_refused_changes_nothing(rig: Rig, name: str, value: Any, reason: str) -> None:
    before = rig.trace(wall())
    settings = rig.node and rig.node.settings
    assert reason in rig.set(**{name: value})
    assert rig.node and rig.node.settings is settings
    np.testing.assert_array_equal(rig.trace(wall()), before)


def test_several_at_once_are_taken_or_refused_together(rig: Rig) -> None:
    assert "variant" in rig.set(bias__constant=1.0, pipeline="brute_force", variant="refit")
    assert rig.node and rig.node.settings.bias_constant == 0.02 and rig.node.settings.pipeline == "light_grid"
    assert rig.set(bias__constant=1.0, pipeline="brute_force", variant="float64") == ""
    assert rig.node.settings.bias_constant == 1.0


def test_pipelines_can_be_switched_and_give_the_same_mask(rig: Rig) -> None:
    before = rig.trace(wall())
    for pipeline, variant in (
        ("brute_force", ""),
        ("brute_force", "float64"),
        ("mesh_bvh", "rebuild"),
        ("mesh_bvh", ""),
        ("cone_hierarchy", "precise_seatp"),
        ("cone_hierarchy", ""),
        ("light_grid", "spherical"),
        ("light_grid", ""),
    ):
        assert rig.set(pipeline=pipeline, variant=variant) == ""
        np.testing.assert_array_equal(rig.mask_of(rig.send_frame(wall()), timeout=120.0), before)
        full = variant or available_pipelines()[pipeline][0]
        rig.wait_status(DEVICE, OK, f"{pipeline}/{full} on cpu")
    assert rig.value(PROCESSING, "faults") == "0"


def test_front_faces_are_culled_if_asked_for(rig: Rig) -> None:
    """The plate shows the light its back; turned over, its front."""
    vertices, triangles = plate()
    shadow = rig.trace(wall())
    assert rig.set(front_face_culling=True) == ""
    np.testing.assert_array_equal(rig.trace(wall()), shadow)
    rig.send_mesh(vertices, triangles[:, ::-1])
    culled = rig.trace(wall())
    assert (culled == 255).sum() == culled.size - 1 and (shadow == 0).sum() > 100
    assert rig.set(front_face_culling=False) == ""
    np.testing.assert_array_equal(rig.trace(wall()), shadow)


def test_lights_come_and_go(rig: Rig) -> None:
    lamp_only = rig.trace(wall())
    assert rig.set(lights=["lamp", "sun"]) == ""
    assert rig.node and rig.node.get_parameter("lights.sun.type").value == "point"
    assert rig.set(lights__sun__type="directional", lights__sun__direction=[1, 0, 1]) == ""
    rig.listen_to_light("sun")
    rig.listen_to_light("lamp")
    stamp = rig.send_frame(wall())
    lamp, sun = rig.mask_of(stamp, "lamp"), rig.mask_of(stamp, "sun")
    np.testing.assert_array_equal(lamp, lamp_only)
    np.testing.assert_array_equal(rig.mask_of(stamp), np.maximum(lamp, sun))
    assert not np.array_equal(lamp, sun)
    assert rig.set(lights=["sun"]) == ""
    assert not rig.node.has_parameter("lights.lamp.type")
    rig.until(lambda: rig.friend.count_publishers("/shadow_tracer/mask/lamp") == 0)
    np.testing.assert_array_equal(rig.trace(wall()), sun)


def test_descriptors_say_what_is_allowed(rig: Rig) -> None:
    assert rig.node
    for name in names_for(["lamp"]):
        descriptor = rig.node.describe_parameter(name)
        assert descriptor.description and not descriptor.dynamic_typing
    bias = rig.node.describe_parameter("bias.constant")
    assert bias.floating_point_range[0].to_value == 10.0 and "m" in bias.additional_constraints
    assert rig.node.describe_parameter("mask.unknown_value").integer_range[0].to_value == 254
    device = rig.node.describe_parameter("device")
    assert device.read_only and "auto, cpu, cuda:N; read-only: buffers" in device.additional_constraints


def test_declared_are_the_parameters_of_the_table_and_no_others() -> None:
    with Rig() as rig:
        assert rig.node
        names = {name for name in rig.node.list_parameters([], 0).names if not name.startswith("qos_overrides.")}
        assert names == {*names_for(["lamp"]), "use_sim_time", "start_type_description_service"}
        assert len(names) == len(PARAMETERS) + len(LIGHT_PARAMETERS) + 2


def test_every_topic_takes_qos_overrides() -> None:
    with Rig() as rig:
        assert rig.node
        names = {
            name.split(".")[1] for name in rig.node.list_parameters([], 0).names if name.startswith("qos_overrides.")
        }
    inputs = {"/depth/image_rect", "/depth/camera_info", "/mesh", "/camera_pose"}
    outputs = {f"/shadow_tracer/{name}" for name in ("mask", "mask/lamp", "camera_info", "timing")}
    assert names >= inputs | outputs | {"/diagnostics"}


def test_integers_and_yaml_style_values_are_taken_at_start() -> None:
    arguments = [
        "-p",
        "bias.constant:=1",
        "-p",
        "lights.lamp.position:=[1, 2, 3]",
        "-p",
        "camera_pose:=[0,0,0,0,0,0,1]",
    ]
    with Rig(arguments=arguments) as rig:
        assert rig.node and rig.node.settings.bias_constant == 1.0
        assert rig.node.settings.lights[0].position == (1.0, 2.0, 3.0)
        assert rig.node.get_parameter("bias.constant").type_ == Parameter.Type.DOUBLE


def test_bad_overrides_are_all_named() -> None:
    with Rig(start=False) as rig, pytest.raises(ParameterError) as caught:
        rig.start({"bias.constant": -1.0, "lights.lamp.type": "laser", "mesh.max_age": "old"})
    assert len(str(caught.value).splitlines()) == 3


def test_misspelt_overrides_are_warned_about(capfd: pytest.CaptureFixture[str]) -> None:
    with Rig({"bias.constnt": 1.0, "lights.lamp.tpye": "spot", "qos_overrides./mesh.subscription.depht": 3}):
        pass
    printed = capfd.readouterr()
    text = printed.out + printed.err
    assert "bias.constnt has no effect" in text and "did you mean bias.constant?" in text
    assert "did you mean lights.lamp.type?" in text
    assert "did you mean qos_overrides./mesh.subscription.depth?" in text


def test_diagnostics_period(rig: Rig) -> None:
    rig.settle(0.2)
    assert rig.set(diagnostics_period=1.0) == ""
    rig.settle(0.1)
    count = len(rig.reports)
    rig.settle(0.6)
    assert len(rig.reports) - count <= 1
    rig.until(lambda: len(rig.reports) - count >= 2)
