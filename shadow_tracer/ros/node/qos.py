# SPDX-License-Identifier: Apache-2.0
"""QoS profiles by purpose, and what a subscription can ask of the publishers there are."""

from __future__ import annotations

from collections.abc import Iterable

from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSPolicyKind, QoSProfile, ReliabilityPolicy
from rclpy.qos_overriding_options import QoSOverridingOptions
from rclpy.topic_endpoint_info import TopicEndpointInfo


def _profile(reliability: ReliabilityPolicy, depth: int) -> QoSProfile:
    return QoSProfile(
        history=HistoryPolicy.KEEP_LAST, depth=depth, reliability=reliability, durability=DurabilityPolicy.VOLATILE
    )


def newest_reliable() -> QoSProfile:
    """Depth images, camera_info, masks, the mesh: none may be lost for want of a fragment; only the newest matters."""
    return _profile(ReliabilityPolicy.RELIABLE, 1)


def every_reliable() -> QoSProfile:
    """Depth images, camera_info, the mesh when each image is to be answered: as many as may wait in the node, too."""
    return _profile(ReliabilityPolicy.RELIABLE, 64)


def newest_of_pose() -> QoSProfile:
    """Poses of lights: best effort, so that every publisher matches; only the newest."""
    return _profile(ReliabilityPolicy.BEST_EFFORT, 1)


def burst() -> QoSProfile:
    """Marker arrays, clouds and queries: reliable, and a burst of them is kept, for each tells of something else."""
    return _profile(ReliabilityPolicy.RELIABLE, 32)


def history_of_sensor() -> QoSProfile:
    """Camera poses: best effort, so that every publisher matches; bursts are kept, the nearest in time is needed."""
    return _profile(ReliabilityPolicy.BEST_EFFORT, 50)


def report() -> QoSProfile:
    """Timing and diagnostics: reliable, a few kept."""
    return _profile(ReliabilityPolicy.RELIABLE, 10)


def latched() -> QoSProfile:
    """Markers out: reliable, and the last message, which says everything, is kept for late joiners."""
    return changed(newest_reliable(), DurabilityPolicy.TRANSIENT_LOCAL, ReliabilityPolicy.RELIABLE)


def overridable(durability: bool = True) -> QoSOverridingOptions:
    """Overrides by the parameters ``qos_overrides.<topic>.{publisher,subscription}.<policy>``."""
    kinds = [QoSPolicyKind.HISTORY, QoSPolicyKind.DEPTH, QoSPolicyKind.RELIABILITY]
    return QoSOverridingOptions([*kinds, QoSPolicyKind.DURABILITY] if durability else kinds)


def changed(profile: QoSProfile, durability: DurabilityPolicy, reliability: ReliabilityPolicy) -> QoSProfile:
    """A copy with another durability and reliability."""
    return QoSProfile(history=profile.history, depth=profile.depth, reliability=reliability, durability=durability)


def matching_durability(publishers: Iterable[TopicEndpointInfo]) -> DurabilityPolicy | None:
    """Transient local if all publishers offer it, so that a mesh published before we came arrives; None without any.

    A subscription that asks for more than one of them offers would be cut off from that one.
    """
    offered = {info.qos_profile.durability for info in publishers}
    if not offered:
        return None
    return (
        DurabilityPolicy.TRANSIENT_LOCAL if offered == {DurabilityPolicy.TRANSIENT_LOCAL} else DurabilityPolicy.VOLATILE
    )


def matching_reliability(publishers: Iterable[TopicEndpointInfo]) -> ReliabilityPolicy | None:
    """Reliable if all publishers offer it; None without any."""
    offered = {info.qos_profile.reliability for info in publishers}
    if not offered:
        return None
    return ReliabilityPolicy.RELIABLE if offered == {ReliabilityPolicy.RELIABLE} else ReliabilityPolicy.BEST_EFFORT


def mismatch(
    publishers: Iterable[TopicEndpointInfo], topic: str, type_name: str, reliability: ReliabilityPolicy
) -> str:
    """Why a subscription to ``topic`` gets nothing from some publisher, and what helps; "" if it gets everything."""
    for info in publishers:
        if info.topic_type != type_name:
            return (
                f"{info.node_name} publishes {info.topic_type} on {topic}, expected {type_name}; remap one of the two"
            )
        best_effort = info.qos_profile.reliability == ReliabilityPolicy.BEST_EFFORT
        if best_effort and reliability == ReliabilityPolicy.RELIABLE:
            return (
                f"{info.node_name} publishes {topic} best effort and cannot be heard reliably; make it reliable, or "
                f"start this node with -p qos_overrides.{topic}.subscription.reliability:=best_effort"
            )
    return ""
