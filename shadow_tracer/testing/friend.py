# SPDX-License-Identifier: Apache-2.0
"""A ROS node that publishes, listens and calls, and waits for conditions instead of sleeping."""

from __future__ import annotations

import time
from collections.abc import Callable
from contextlib import ExitStack
from typing import Any

import rclpy
from rclpy.client import Client
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import DurabilityPolicy

from shadow_tracer.testing.isolation import isolated
from shadow_tracer.testing.messages import reliable
from shadow_tracer.testing.process import NotInTime

TIMEOUT = 20.0
_PATIENCE = 5.0  # s: so long a client may look for its service before it is replaced
_LATENCY = 0.02  # s: a condition is asked about at least this often, also where no message comes


class Friend:
    """What talks to nodes, in a private domain. Use as a context manager.

    Nothing here runs in a thread: callbacks of subscriptions, and of nodes given to :meth:`add`, run while a method
    waits. What does not come in time raises :class:`NotInTime`.

    Args:
        namespace: of the friend.
        domain: as for :func:`isolated`.

    Attributes:
        context: what your own nodes are to be made with.
        executor: what runs them.
        friend: the ROS node.
        domain: the ROS domain.
    """

    def __init__(self, namespace: str = "", domain: int | None = None) -> None:
        self._publishers: dict[Any, Publisher] = {}
        self._collected: dict[str, list[Any]] = {}
        self._clients: dict[str, Client] = {}
        self._left = ExitStack()  # what is to be undone, in reverse
        self._running = ExitStack()  # and what before all that
        try:
            self.domain = self._left.enter_context(isolated(domain))
            self.context = Context()
            rclpy.init(context=self.context, args=[])
            self._left.callback(rclpy.try_shutdown, context=self.context)
            self.friend = Node("friend", context=self.context, namespace=namespace or None)
            self._left.callback(self.friend.destroy_node)
            self.executor = SingleThreadedExecutor(context=self.context)
            self._running.callback(self.executor.shutdown, timeout_sec=0.0)
            self.executor.add_node(self.friend)
        except BaseException:
            self.close()
            raise

    def close(self) -> None:
        """End everything that was started: no process, thread, node or shared memory is left."""
        with self._left:
            self._running.close()

    def __enter__(self) -> Any:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def add(self, node: Node) -> Any:
        """Run your own node too, made with ``context=harness.context``; it is destroyed in the end. Returns it."""
        if node.context is not self.context:
            raise ValueError("node: expected one that was made with context=harness.context, got another context")
        self._left.callback(node.destroy_node)
        self.executor.add_node(node)
        return node

    def until(self, predicate: Callable[[], Any], timeout: float = TIMEOUT, what: str = "the expected") -> Any:
        """Run callbacks until the predicate is true; returns its value.

        Args:
            predicate: asked after each callback.
            timeout: seconds, above 0.
            what: what is waited for, for the message.

        Raises:
            NotInTime: after ``timeout`` seconds; the message says what was waited for, and what came last.
        """
        if not timeout > 0.0:
            raise ValueError(f"timeout: expected seconds above 0, got {timeout!r}")
        deadline = time.monotonic() + timeout
        while True:
            value = predicate()
            if value:
                return value
            self._check(what)
            if time.monotonic() > deadline:
                raise NotInTime(f"not within {timeout:g} s: {what}; {self.heard()}")
            self.executor.spin_once(timeout_sec=_LATENCY)

    def listen(self, kind: Any, topic: str, into: list[Any]) -> Any:
        """Collect the messages of a topic in a list; returns the subscription."""
        return self.friend.create_subscription(kind, topic, into.append, reliable(50))

    def collect(self, kind: Any, topic: str, timeout: float = TIMEOUT) -> list[Any]:
        """The list of all messages of a topic from the first call on, which waits for somebody who publishes it."""
        if topic not in self._collected:
            into: list[Any] = []
            subscription = self.listen(kind, topic, into)
            try:
                self.until(lambda: subscription.get_publisher_count() > 0, timeout, f"{topic} is published")
            except NotInTime:
                self.friend.destroy_subscription(subscription)
                raise
            self._collected[topic] = into
        return self._collected[topic]

    def publisher(
        self,
        kind: Any,
        topic: str,
        durability: DurabilityPolicy = DurabilityPolicy.VOLATILE,
        timeout: float = TIMEOUT,
    ) -> Publisher:
        """A reliable publisher that somebody listens to, made at the first call."""
        key = (topic, durability)
        if key not in self._publishers:
            self._publishers[key] = self.friend.create_publisher(kind, topic, reliable(50, durability))
        made = self._publishers[key]
        self.until(lambda: made.get_subscription_count() > 0, timeout, f"somebody listens to {topic}")
        return made

    def client(self, kind: Any, service: str, timeout: float = 3 * TIMEOUT) -> Client:
        """A client of a service that is there, made at the first call.

        A client that is made while the service is being discovered may never find it, though the graph has it and the
        next client does (rmw_fastrtps, about one in 300 beside other work); so another is made after a while.
        """
        begun = time.monotonic()

        def ready() -> bool:
            nonlocal begun
            if service in self._clients and time.monotonic() - begun > _PATIENCE:
                self.friend.destroy_client(self._clients.pop(service))
                begun = time.monotonic()
            if service not in self._clients:
                self._clients[service] = self.friend.create_client(kind, service)
            return bool(self._clients[service].service_is_ready())

        self.until(ready, timeout, f"{service} is there")
        return self._clients[service]

    def request(self, kind: Any, service: str, request: Any = None, timeout: float = 3 * TIMEOUT) -> Any:
        """Call a service, which is waited for; the future of its response."""
        client = self.client(kind, service, timeout)
        return client.call_async(kind.Request() if request is None else request)

    def call(self, kind: Any, service: str, request: Any = None, timeout: float = TIMEOUT) -> Any:
        """Call a service and wait for its response."""
        future = self.request(kind, service, request)
        self.until(future.done, timeout, f"{service} answers")
        return future.result()

    def heard(self) -> str:
        """What came last, in words."""
        return "; ".join(f"{len(messages)} messages of {topic}" for topic, messages in self._collected.items())

    def _check(self, what: str) -> None:
        """Raise NotInTime if there is no hope for what is waited for."""
