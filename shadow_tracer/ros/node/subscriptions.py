# SPDX-License-Identifier: Apache-2.0
"""A subscription that follows its publishers: it asks for what all of them offer, and says when one cannot be heard."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rclpy.subscription import Subscription

from shadow_tracer.ros.node import qos


class FollowingSubscription:
    """A subscription to bytes with overridable QoS, rebuilt when its publishers call for another profile.

    Args:
        node: the node.
        kind: message class.
        topic: name before remapping.
        callback: of the messages; guarded by the caller.
        profile: what is asked for until somebody publishes.
        durability: take the durability that all publishers offer.
        reliability: take the reliability that all publishers offer.

    Attributes:
        mismatch: why some publisher cannot be heard, and what helps; "" if all can.
    """

    def __init__(
        self, node: Node, kind: Any, topic: str, callback: Callable[..., None], profile: QoSProfile, *,
        durability: bool = False, reliability: bool = False,
    ) -> None:  # fmt: skip
        self.mismatch = ""
        self._node = node
        self._kind = kind
        self._topic = topic
        self._callback = callback
        prefix = f"qos_overrides.{node.resolve_topic_name(topic)}.subscription."
        given = getattr(node, "_parameter_overrides", {})
        self._given = {name[len(prefix) :] for name in given if name.startswith(prefix)}
        self._follow_durability = durability and "durability" not in self._given
        self._follow_reliability = reliability and "reliability" not in self._given
        self._subscription: Subscription = node.create_subscription(
            kind, topic, callback, profile, raw=True, event_callbacks=self._events(),
            qos_overriding_options=qos.overridable(durability=not self._follow_durability),
        )  # fmt: skip

    @property
    def topic(self) -> str:
        """Name of the topic after remapping."""
        return str(self._subscription.topic_name)

    @property
    def profile(self) -> QoSProfile:
        """What is asked for now."""
        return self._subscription.qos_profile

    @property
    def publisher_count(self) -> int:
        """Publishers that are heard."""
        return int(self._subscription.get_publisher_count())

    @property
    def best_effort(self) -> bool:
        """Whether lost messages are not sent again."""
        return bool(self.profile.reliability == ReliabilityPolicy.BEST_EFFORT)

    def match(self) -> None:
        """Look at the publishers, and follow them."""
        publishers = self._node.get_publishers_info_by_topic(self.topic)
        profile = self.profile
        durability = qos.matching_durability(publishers) if self._follow_durability else None
        reliability = qos.matching_reliability(publishers) if self._follow_reliability else None
        wanted = qos.changed(profile, durability or profile.durability, reliability or profile.reliability)
        if (wanted.durability, wanted.reliability) != (profile.durability, profile.reliability):
            self._make(wanted)
        self.mismatch = qos.mismatch(publishers, self.topic, _type_name(self._kind), self.profile.reliability)

    def ask(self, depth: int) -> None:
        """Ask for another depth of the queue, if no override says otherwise."""
        now = self.profile
        if "depth" not in self._given and depth != now.depth:
            wanted = qos.changed(now, now.durability, now.reliability)
            wanted.depth = depth
            self._make(wanted)

    def close(self) -> None:
        """Unsubscribe."""
        self._node.destroy_subscription(self._subscription)

    def _make(self, profile: QoSProfile) -> None:
        # Without overriding options: they would put back what was asked for at the start.
        self._node.destroy_subscription(self._subscription)
        self._subscription = self._node.create_subscription(
            self._kind, self._topic, self._callback, profile, raw=True, event_callbacks=self._events()
        )

    def _events(self) -> SubscriptionEventCallbacks:
        """Without the warning of rclpy that a publisher cannot be heard where that is put right a moment later."""
        return SubscriptionEventCallbacks(use_default_callbacks=not self._follow_reliability)


class AbsentSubscription:
    """Stands for a subscription to a type that there is not here: it hears nothing, and says so where somebody
    publishes.

    Args:
        node: the node.
        topic: name before remapping.
        cure: what is missing, and what helps.

    Attributes:
        mismatch: as of :class:`FollowingSubscription`.
    """

    def __init__(self, node: Node, topic: str, cure: str) -> None:
        self.mismatch = ""
        self._node = node
        self._cure = cure
        self.topic = str(node.resolve_topic_name(topic))

    def match(self) -> None:
        """Look whether anybody publishes."""
        publishers = self._node.get_publishers_info_by_topic(self.topic)
        self.mismatch = f"{publishers[0].node_name} publishes {self.topic}, but {self._cure}" if publishers else ""

    def close(self) -> None:
        """Nothing is there to be closed."""


def _type_name(kind: Any) -> str:
    package, folder, *_ = str(kind.__module__).split(".")
    return f"{package}/{folder}/{kind.__name__}"


def keeps_for_late_joiners(profile: QoSProfile) -> bool:
    """Whether messages are kept for subscriptions that come later, so that they matter with nobody listening."""
    return bool(profile.durability != DurabilityPolicy.VOLATILE)
