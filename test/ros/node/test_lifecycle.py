# SPDX-License-Identifier: Apache-2.0
"""The managed node: what it does in each state, that a state can be left and come back to, and how the program ends."""

from __future__ import annotations

import signal
import threading
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
from harness import NodeProcess, Rig, image_msg, plate, reliable, wall
from lifecycle_msgs.msg import State, Transition
from lifecycle_msgs.srv import ChangeState, GetState
from rcl_interfaces.msg import Parameter as ParameterMsg
from rcl_interfaces.msg import ParameterValue
from rcl_interfaces.srv import GetParameters, SetParameters
from rclpy.lifecycle import TransitionCallbackReturn
from sensor_msgs.msg import Image
from std_srvs.srv import Trigger

from shadow_tracer.ros.diagnostics import DEPTH, DEVICE, ERROR, MESH, OK, PROCESSING, TRANSFORMS
from shadow_tracer.ros.node import tracer_host
from shadow_tracer.ros.node.lifecycle_node import ShadowLifecycleNode

COMMAND = ("-c", "import sys; from shadow_tracer.ros.node.process import lifecycle_main; sys.exit(lifecycle_main())")
INPUTS = ("depth/image_rect", "depth/camera_info", "mesh", "mesh_markers", "mesh_marker", "mesh_cloud", "camera_pose")


def change(rig: Rig, transition: int) -> bool:
    """Ask for a transition; whether it succeeded."""
    request = ChangeState.Request(transition=Transition(id=transition))
    return bool(rig.call(ChangeState, "shadow_tracer/change_state", request, timeout=60.0).success)


def state(rig: Rig) -> int:
    return int(rig.call(GetState, "shadow_tracer/get_state").current_state.id)


def listening(rig: Rig) -> set[str]:
    """The inputs that the node subscribes to."""
    return {topic for topic in (*INPUTS, "query") if rig.friend.count_subscribers(f"/{topic}")}


@pytest.fixture
def rig() -> Iterator[Rig]:
    """A managed node, unconfigured."""
    with Rig(start=False) as made:
        made.start(kind=ShadowLifecycleNode, wait=False)
        yield made


def activate(rig: Rig) -> None:
    assert change(rig, Transition.TRANSITION_ACTIVATE)
    rig.connected()


def test_a_whole_life(rig: Rig) -> None:
    assert state(rig) == State.PRIMARY_STATE_UNCONFIGURED and not listening(rig)
    rig.wait_status(DEVICE, OK, "no tracer yet: configure the node")
    rig.wait_status(DEPTH, OK, "not listening: the node is not active")
    assert change(rig, Transition.TRANSITION_CONFIGURE)
    assert state(rig) == State.PRIMARY_STATE_INACTIVE and not listening(rig)
    rig.wait_status(DEVICE, OK, "light_grid/packed on cpu")
    activate(rig)
    assert state(rig) == State.PRIMARY_STATE_ACTIVE and listening(rig) == {*INPUTS, "query"}
    rig.send_mesh(*plate())
    shadow = rig.trace(wall())
    assert (shadow == 0).sum() > 100
    waiting = rig.send_frame(wall(), info=False)
    rig.until(lambda: len(rig.core.inputs.cameras[""].queue) == 1)

    assert change(rig, Transition.TRANSITION_DEACTIVATE)
    assert state(rig) == State.PRIMARY_STATE_INACTIVE
    rig.until(lambda: not listening(rig), what="the node hears nothing")
    count = len(rig.masks[""])
    rig.send_frame(wall())
    rig.wait_status(DEPTH, OK, "not listening")
    rig.settle(0.2)
    assert len(rig.masks[""]) == count and waiting not in {m.header.stamp.nanosec for m in rig.masks[""]}

    activate(rig)
    np.testing.assert_array_equal(rig.trace(wall()), shadow)  # the mesh is still there
    assert change(rig, Transition.TRANSITION_DEACTIVATE)
    made = rig.core.host.made
    assert change(rig, Transition.TRANSITION_CLEANUP)
    assert state(rig) == State.PRIMARY_STATE_UNCONFIGURED and rig.core.host.made is None and made is not None
    rig.wait_status(DEVICE, OK, "no tracer yet")

    assert change(rig, Transition.TRANSITION_CONFIGURE)
    activate(rig)
    assert (rig.trace(wall()).ravel()[1:] == 255).all()  # the mesh went with the clean-up
    rig.send_mesh(*plate())
    np.testing.assert_array_equal(rig.trace(wall()), shadow)
    assert change(rig, Transition.TRANSITION_ACTIVE_SHUTDOWN)
    assert state(rig) == State.PRIMARY_STATE_FINALIZED and rig.core.host.made is None
    rig.until(lambda: not listening(rig))
    rig.until(lambda: rig.value(PROCESSING, "faults") == "0")


@pytest.mark.parametrize("configured", [False, True])
def test_shutdown_from_every_state(rig: Rig, configured: bool) -> None:
    if configured:
        assert change(rig, Transition.TRANSITION_CONFIGURE)
    name = "INACTIVE" if configured else "UNCONFIGURED"
    assert change(rig, getattr(Transition, f"TRANSITION_{name}_SHUTDOWN"))
    assert state(rig) == State.PRIMARY_STATE_FINALIZED
    assert rig.core.host.made is None


def test_wrong_transitions_change_nothing(rig: Rig) -> None:
    """And are answered: rclpy itself raises out of its service, and whoever asked waits for ever."""
    assert not change(rig, Transition.TRANSITION_ACTIVATE)
    assert state(rig) == State.PRIMARY_STATE_UNCONFIGURED
    assert change(rig, Transition.TRANSITION_CONFIGURE)
    assert not change(rig, Transition.TRANSITION_CONFIGURE) and not change(rig, 77)
    assert state(rig) == State.PRIMARY_STATE_INACTIVE
    activate(rig)
    assert not change(rig, Transition.TRANSITION_CLEANUP)
    rig.trace(wall())


def by_label(rig: Rig, label: str) -> bool:
    request = ChangeState.Request(transition=Transition(label=label))
    return bool(rig.call(ChangeState, "shadow_tracer/change_state", request, timeout=60.0).success)


def test_transitions_by_their_labels(rig: Rig) -> None:
    assert not by_label(rig, "activate") and not by_label(rig, "nonsense")
    assert by_label(rig, "configure") and state(rig) == State.PRIMARY_STATE_INACTIVE
    assert by_label(rig, "activate") and state(rig) == State.PRIMARY_STATE_ACTIVE
    rig.connected()
    rig.trace(wall())


@pytest.fixture
def gate(monkeypatch: pytest.MonkeyPatch) -> Iterator[threading.Event]:
    """Holds up the thread that compiles kernels until it is set."""
    opened = threading.Event()
    real = tracer_host.ShadowTracer

    def slow(**arguments: Any) -> Any:
        assert opened.wait(60.0)
        return real(**arguments)

    monkeypatch.setattr(tracer_host, "ShadowTracer", slow)
    yield opened
    opened.set()


def configuring(rig: Rig) -> Any:
    """Ask for the transition; the future of its answer, once the node is at it."""
    request = ChangeState.Request(transition=Transition(id=Transition.TRANSITION_CONFIGURE))
    answer = rig.request(ChangeState, "shadow_tracer/change_state", request)
    rig.until(lambda: rig.core.host.doing == "start")
    return answer


def test_while_it_compiles_everything_is_answered(rig: Rig, gate: threading.Event) -> None:
    """The state, parameters and services, and diagnostics goes on."""
    answer = configuring(rig)
    assert state(rig) == State.TRANSITION_STATE_CONFIGURING
    asked = rig.call(GetParameters, "shadow_tracer/get_parameters", GetParameters.Request(names=["light_names"]))
    assert list(asked.values[0].string_array_value) == ["lamp"]
    change_of = ParameterMsg(name="bias.constant", value=ParameterValue(type=3, double_value=0.07))
    request = SetParameters.Request(parameters=[change_of])
    assert rig.call(SetParameters, "shadow_tracer/set_parameters", request).results[0].successful
    assert rig.call(Trigger, "shadow_tracer/clear_meshes").success
    rig.wait_status(DEVICE, OK, "starting up for")
    reports = len(rig.reports)
    rig.until(lambda: len(rig.reports) > reports + 3, what="diagnostics goes on")
    for wrong in (Transition.TRANSITION_CONFIGURE, Transition.TRANSITION_ACTIVATE, Transition.TRANSITION_CLEANUP):
        assert not change(rig, wrong)
    assert not answer.done() and state(rig) == State.TRANSITION_STATE_CONFIGURING
    gate.set()
    rig.until(answer.done)
    assert answer.result().success and state(rig) == State.PRIMARY_STATE_INACTIVE
    activate(rig)
    rig.trace(wall())
    assert rig.node and rig.node.settings.bias.constant == 0.07


def test_an_error_of_the_node_itself_leads_back_to_unconfigured(rig: Rig, monkeypatch: pytest.MonkeyPatch) -> None:
    def broken() -> None:
        raise OSError("no thread can be started")

    monkeypatch.setattr(rig.core, "start", broken)
    assert not change(rig, Transition.TRANSITION_CONFIGURE)
    assert state(rig) == State.PRIMARY_STATE_UNCONFIGURED
    rig.wait_status(PROCESSING, ERROR, "no thread can be started")
    monkeypatch.undo()
    assert change(rig, Transition.TRANSITION_CONFIGURE)


def test_configuring_from_within_the_process(rig: Rig) -> None:
    """`trigger_configure` returns when it is done."""
    assert rig.node
    assert rig.node.trigger_configure() == TransitionCallbackReturn.SUCCESS
    assert state(rig) == State.PRIMARY_STATE_INACTIVE
    activate(rig)


def test_parameters_set_before_configuring_count(rig: Rig) -> None:
    """Also those that a running node takes over in its thread."""
    assert rig.set(pipeline="mesh_bvh", variant="rebuild") == ""
    assert rig.set(verify_every=1, bias__constant=0.05, light_names=["sky"]) == ""
    assert rig.set(lights__sky__type="directional") == ""
    assert change(rig, Transition.TRANSITION_CONFIGURE)
    rig.wait_status(DEVICE, OK, "mesh_bvh/rebuild on cpu")
    activate(rig)
    rig.send_mesh(*plate())
    assert (rig.trace(wall()) == 0).any()
    rig.until(lambda: rig.value(PROCESSING, "verified frames") == "1")
    assert change(rig, Transition.TRANSITION_DEACTIVATE)
    assert rig.set(pipeline="brute_force", variant="") == ""  # while inactive
    activate(rig)
    assert (rig.trace(wall()) == 0).any()
    rig.wait_status(DEVICE, OK, "brute_force/filtered on cpu")


def test_while_inactive_parameters_do_not_make_it_listen(rig: Rig, monkeypatch: pytest.MonkeyPatch) -> None:
    import sys

    from tf_double import module

    double, made = module()
    monkeypatch.setitem(sys.modules, "tf2_ros", double)
    assert change(rig, Transition.TRANSITION_CONFIGURE)
    assert rig.set(fixed_frame="map", light_names=["lamp", "other"], process="every") == ""
    rig.settle(0.1)
    assert not made and not listening(rig)
    assert rig.friend.count_subscribers("/shadow_tracer/lights/other/pose") == 0
    activate(rig)
    assert len(made) == 1 and rig.friend.count_subscribers("/shadow_tracer/lights/other/pose") == 1
    rig.until(lambda: rig.value(TRANSFORMS, "tf") == "listening")


def test_a_bad_device_fails_to_configure_and_can_be_tried_again() -> None:
    with Rig(start=False) as rig:
        rig.start({"device": "cuda:63"}, kind=ShadowLifecycleNode, wait=False)
        for _ in range(2):
            assert not change(rig, Transition.TRANSITION_CONFIGURE)
            assert state(rig) == State.PRIMARY_STATE_UNCONFIGURED
            rig.wait_status(DEVICE, ERROR, "the tracer cannot be made: device")


def test_what_failed_once_may_work_the_next_time(rig: Rig, monkeypatch: pytest.MonkeyPatch) -> None:
    def broken(**_: Any) -> None:
        raise MemoryError("another program has all the memory")

    monkeypatch.setattr(tracer_host, "ShadowTracer", broken)
    assert not change(rig, Transition.TRANSITION_CONFIGURE)
    rig.wait_status(DEVICE, ERROR, "another program has all the memory")
    monkeypatch.undo()
    assert change(rig, Transition.TRANSITION_CONFIGURE)
    rig.wait_status(DEVICE, OK, "light_grid/packed on cpu")
    activate(rig)
    rig.trace(wall())


def test_services_in_every_state(rig: Rig) -> None:
    from diagnostic_msgs.srv import SelfTest

    response = rig.call(SelfTest, "shadow_tracer/self_test")
    assert response.passed == b"\x00" and "configure the node first" in response.status[0].message
    assert rig.call(Trigger, "shadow_tracer/clear_meshes").success
    assert change(rig, Transition.TRANSITION_CONFIGURE)
    assert rig.call(SelfTest, "shadow_tracer/self_test", timeout=60.0).passed == b"\x01"
    activate(rig)
    rig.send_mesh(*plate())
    assert rig.call(Trigger, "shadow_tracer/clear_meshes").message.startswith("1 parts cleared")


def test_cleaning_up_waits_for_what_runs(rig: Rig, monkeypatch: pytest.MonkeyPatch) -> None:
    """A clean-up while a self test runs is refused, and works afterwards."""
    gate = threading.Event()
    monkeypatch.setattr(tracer_host, "run", lambda *_, **__: gate.wait(60.0) and [])
    assert change(rig, Transition.TRANSITION_CONFIGURE)
    rig.core.host.self_test(lambda _outcome: None)
    assert not change(rig, Transition.TRANSITION_CLEANUP)
    assert state(rig) == State.PRIMARY_STATE_INACTIVE
    gate.set()
    rig.until(lambda: not rig.core.host.busy)
    assert change(rig, Transition.TRANSITION_CLEANUP)
    assert state(rig) == State.PRIMARY_STATE_UNCONFIGURED


def test_an_activation_that_fails_midway_leaves_nothing_behind(rig: Rig, monkeypatch: pytest.MonkeyPatch) -> None:
    """Back to unconfigured, from where it can be tried again."""

    def broken(*_: Any) -> None:
        raise OSError("the disk is gone")

    assert change(rig, Transition.TRANSITION_CONFIGURE)
    monkeypatch.setattr(rig.core.inputs.meshes, "load_files", broken)
    assert not change(rig, Transition.TRANSITION_ACTIVATE)
    assert state(rig) == State.PRIMARY_STATE_UNCONFIGURED and rig.core.host.made is None
    rig.until(lambda: not listening(rig))
    monkeypatch.undo()
    assert change(rig, Transition.TRANSITION_CONFIGURE)
    activate(rig)
    rig.trace(wall())


def test_files_are_read_when_it_becomes_active(tmp_path: Any) -> None:
    trimesh = pytest.importorskip("trimesh")
    path = tmp_path / "a.ply"
    with Rig(start=False) as rig:
        rig.start({"mesh.files": [str(path)]}, kind=ShadowLifecycleNode, wait=False)
        assert change(rig, Transition.TRANSITION_CONFIGURE)
        trimesh.Trimesh(*plate(), process=False).export(path)
        activate(rig)
        assert (rig.trace(wall()) == 0).any()
        assert change(rig, Transition.TRANSITION_DEACTIVATE)
        trimesh.Trimesh(*plate(half=0.01), process=False).export(path)
        activate(rig)
        assert (rig.trace(wall()) == 0).sum() < 10
        rig.until(lambda: rig.value(MESH, "parts") == "1")


@pytest.mark.slow
@pytest.mark.parametrize(
    ("number", "when"),
    [
        (signal.SIGINT, "unconfigured"),
        (signal.SIGINT, "configuring"),
        (signal.SIGTERM, "configuring"),
        (signal.SIGTERM, "active"),
    ],
)
def test_signals_end_the_program_cleanly(number: signal.Signals, when: str, tmp_path: Any) -> None:
    environment = {"WARP_CACHE_PATH": str(tmp_path)} if when == "configuring" else {}
    with NodeProcess(command=COMMAND, environment=environment) as process, Rig(start=False) as rig:
        rig.until(lambda: rig.status(DEVICE), timeout=60.0)
        if when == "configuring":  # kernels are compiled for a long time
            request = ChangeState.Request(transition=Transition(id=Transition.TRANSITION_CONFIGURE))
            rig.request(ChangeState, "shadow_tracer/change_state", request)
            process.wait_for("starting up")
        elif when == "active":
            assert change(rig, Transition.TRANSITION_CONFIGURE)
            activate(rig)
            rig.trace(wall())
        assert process.stop(number, timeout=10.0) == (0, "")
        assert not any("[ERROR]" in line for line in process.out), process.out


@pytest.mark.slow
def test_a_bad_parameter_is_an_error_of_the_program() -> None:
    with NodeProcess({"pose_source": "gps"}, command=COMMAND) as process:
        code, errors = process.wait()
        assert code == 1 and "pose_source: expected" in errors and "Traceback" not in errors


def test_masks_of_a_managed_node_reach_late_listeners(rig: Rig) -> None:
    """Its publishers are there in every state, so that nobody has to wait for a match."""
    into: list[Image] = []
    rig.friend.create_subscription(Image, "shadow_tracer/mask/lamp", into.append, reliable())
    assert rig.friend.count_publishers("/shadow_tracer/mask") == 1
    assert change(rig, Transition.TRANSITION_CONFIGURE)
    activate(rig)
    rig.trace(wall())
    rig.until(lambda: into)
    assert not rig.core.inputs.cameras[""].queue.dropped and image_msg(wall(), 0).height == into[0].height
