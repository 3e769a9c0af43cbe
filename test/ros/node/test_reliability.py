# SPDX-License-Identifier: Apache-2.0
"""Depth images and camera_info are taken as all their publishers offer them: reliably if they can."""

from __future__ import annotations

from typing import Any

import pytest
from harness import Rig, plate, wall
from rclpy.qos import QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import CameraInfo, Image

from shadow_tracer.ros.diagnostics import DEPTH, ERROR, OK

RELIABLE, BEST_EFFORT = ReliabilityPolicy.RELIABLE, ReliabilityPolicy.BEST_EFFORT
KINDS: dict[str, tuple[Any, str]] = {"depth": (Image, "depth/image_rect"), "info": (CameraInfo, "depth/camera_info")}


def taken(rig: Rig) -> dict[str, Any]:
    """Reliability of the two subscriptions."""
    return {name: rig.core.inputs.subscriptions[name].profile.reliability for name in KINDS}


def camera(rig: Rig, reliability: ReliabilityPolicy) -> list[Any]:
    """Publishers of both."""
    profile = QoSProfile(depth=10, reliability=reliability)
    return [rig.friend.create_publisher(kind, topic, profile) for kind, topic in KINDS.values()]


def best_effort_rig(rig: Rig) -> None:
    """The publishers of the rig become best effort."""
    for publisher in (rig.depth, rig.info):
        rig.friend.destroy_publisher(publisher)
    rig.depth, rig.info = camera(rig, BEST_EFFORT)


def test_a_reliable_camera_is_taken_reliably_from_its_first_image() -> None:
    with Rig() as rig:
        first = {name: rig.core.inputs.subscriptions[name]._subscription for name in KINDS}
        assert taken(rig) == {"depth": RELIABLE, "info": RELIABLE}
        rig.send_mesh(*plate())
        rig.trace(wall())
        for subscription in rig.core.inputs.subscriptions.values():
            subscription.match()
        assert rig.set(process="every") == "" and rig.set(process="latest") == "" and rig.set(bias__constant=0.01) == ""
        assert taken(rig) == {"depth": RELIABLE, "info": RELIABLE}
        assert first["depth"].qos_profile.reliability == RELIABLE
        rig.trace(wall())


@pytest.mark.slow
def test_a_best_effort_camera_is_heard_and_a_reliable_one_later_taken_reliably(
    capfd: pytest.CaptureFixture[str],
) -> None:
    with Rig(start=False) as rig:
        best_effort_rig(rig)
        rig.start(wait=False)
        rig.until(lambda: taken(rig) == {"depth": BEST_EFFORT, "info": BEST_EFFORT})
        rig.until(lambda: rig.node and rig.node.ready, 120.0)
        rig.connected()
        rig.trace(wall())
        rig.wait_status(DEPTH, OK)
        assert rig.set(bias__constant=0.01) == "" and set(taken(rig).values()) == {BEST_EFFORT}
        second = camera(rig, RELIABLE)
        rig.settle(1.5)
        assert set(taken(rig).values()) == {BEST_EFFORT}  # all have to offer it
        for publisher in (rig.depth, rig.info):
            rig.friend.destroy_publisher(publisher)
        rig.depth, rig.info = second
        rig.until(lambda: taken(rig) == {"depth": RELIABLE, "info": RELIABLE})
        rig.connected()
        rig.trace(wall())
    log = "".join(capfd.readouterr()).splitlines()
    assert not [line for line in log if "[shadow_tracer]" in line and "incompatible" in line]


def test_an_override_has_the_last_word() -> None:
    def override(policy: str) -> dict[str, str]:
        return {f"qos_overrides./{topic}.subscription.reliability": policy for _, topic in KINDS.values()}

    with Rig(override("best_effort")) as rig:
        for subscription in rig.core.inputs.subscriptions.values():
            subscription.match()
        assert rig.set(process="every") == "" and set(taken(rig).values()) == {BEST_EFFORT}
    with Rig(start=False) as rig:
        best_effort_rig(rig)
        rig.start(override("reliable"), wait=False)
        rig.wait_status(DEPTH, ERROR, "publishes /depth/image_rect best effort and cannot be heard reliably", 60.0)
        assert set(taken(rig).values()) == {RELIABLE}
