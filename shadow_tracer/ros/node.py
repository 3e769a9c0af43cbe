# SPDX-License-Identifier: Apache-2.0
"""The node ``shadow_tracer``: wiring of subscriptions, publishers, timers and executor, nothing else.

``main`` is the program ``shadow_node``; it lives in :mod:`process`, which imports this module once signals are under
control.
"""

from __future__ import annotations

import functools
import sys
import time
from collections.abc import Callable
from contextlib import suppress
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PoseStamped
from rcl_interfaces.msg import SetParametersResult
from rclpy.clock import Clock, ClockType, JumpThreshold
from rclpy.duration import Duration
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.publisher import Publisher
from rclpy.qos import DurabilityPolicy, QoSProfile
from sensor_msgs.msg import CameraInfo, Image
from shape_msgs.msg import Mesh

from shadow_tracer.ros import diagnostics, qos
from shadow_tracer.ros.frame_queue import FrameQueue, WaitingFrame
from shadow_tracer.ros.frames import Frames, Tf2
from shadow_tracer.ros.health import Health
from shadow_tracer.ros.mesh_input import MeshInput
from shadow_tracer.ros.messages import MessageError, decode_depth, mask_image, pose_matrix, stamp_ns
from shadow_tracer.ros.parameter_server import ParameterServer
from shadow_tracer.ros.process import main
from shadow_tracer.ros.processing import Answer, Mask, Processor
from shadow_tracer.ros.settings import Settings
from shadow_tracer.ros.tracer_host import TracerHost

_RETRY_PERIOD = 0.01
MATCH_PERIOD = 0.5  # also the longest time a signal goes unnoticed
_TOO_MANY_FAULTS = 100
_BACKWARD_STAMPS = 1_000_000_000  # images this much older than the last one mean a restarted bag, not a late message

__all__ = ["ShadowNode", "StartupError", "main", "spin"]


class StartupError(RuntimeError):
    """The tracer cannot be made: the node has no purpose and ends with exit code 1."""


class ShadowNode(Node):
    """Depth images, camera_info, mesh and poses in; masks, timing and diagnostics out.

    Args:
        kwargs: as for :class:`rclpy.node.Node`: ``context``, ``cli_args``, ``parameter_overrides``, ``namespace``.

    Raises:
        ParameterError: a parameter override is bad.
    """

    def __init__(self, **kwargs: Any) -> None:
        self._server: ParameterServer | None = None
        super().__init__("shadow_tracer", **kwargs)
        self._server = server = ParameterServer(self, self._on_settings)
        self._steady = Clock(clock_type=ClockType.STEADY_TIME)
        self._queue = FrameQueue()
        self._mesh = MeshInput()
        self._frames = Frames(lambda: Tf2(self))
        self._processor = Processor(self._queue, self._frames, self._mesh)
        self._work = self.create_guard_condition(self._guarded(self._step))
        self._host = TracerHost(self.wake)
        self._last_stamp = self._last_number = 0
        self._subscribe()
        self._health = Health(self._label(), self._topics(), self._queue, self._frames, self._mesh)
        self._mask_out = self._publisher(Image, "~/mask")
        self._info_out = self._publisher(CameraInfo, "~/camera_info")
        self._timing_out = self._publisher(DiagnosticArray, "~/timing", qos.report())
        self._diagnostics_out = self._publisher(DiagnosticArray, "/diagnostics", qos.report())
        self._light_out: dict[str, Publisher] = {}
        self._match_lights(server.settings)
        self._frames.configure(server.settings)
        self._retry = self._timer(_RETRY_PERIOD, self._step)
        self._retry.cancel()
        self._matching = self._timer(MATCH_PERIOD, self._match_publishers)
        self._reporting = self._timer(server.settings.diagnostics_period, self._report)
        backward = JumpThreshold(min_forward=None, min_backward=Duration(nanoseconds=-1), on_clock_change=False)
        self._jumps = self.get_clock().create_jump_callback(backward, post_callback=self._guarded(self._on_jump))
        for warning in server.warnings():
            self.get_logger().warning(warning)
        self.get_logger().info("starting up: kernels are compiled the first time, which can take a minute")
        self._host.start(server.settings)

    @property
    def settings(self) -> Settings:
        """The parameters, checked and converted."""
        if self._server is None:
            raise RuntimeError("settings: the node is still being made")
        return self._server.settings

    @property
    def ready(self) -> bool:
        """True once frames are traced; False while kernels are compiled."""
        return self._host.tracer is not None

    def set_parameters(self, parameter_list: list[Parameter]) -> list[SetParametersResult]:
        """As rclpy's, with refusals that say why."""
        return [self.set_parameters_atomically([parameter]) for parameter in parameter_list]

    def set_parameters_atomically(self, parameter_list: list[Parameter]) -> SetParametersResult:
        """As rclpy's, with refusals that say why."""
        reason = self._server.refusal(parameter_list) if self._server else ""
        if reason:
            return SetParametersResult(successful=False, reason=reason)
        return super().set_parameters_atomically(parameter_list)

    def note_fault(self, error: Exception) -> None:
        """Count and log an exception that should not have happened; the node goes on."""
        text = f"{type(error).__name__}: {error}"
        self._health.faults.add(text, time.monotonic())
        self.get_logger().error(text, throttle_duration_sec=5.0)

    def wake(self) -> None:
        """Make a spinning executor come back; may be called from any thread, also after the node was destroyed."""
        with suppress(Exception):
            self._work.trigger()

    def close(self, timeout: float = 0.5) -> bool:
        """Destroy the node. False if the tracer's thread is still compiling after ``timeout`` seconds."""
        self._jumps.unregister()
        self.destroy_node()
        return self._host.join(timeout)

    # Wiring

    def _subscribe(self) -> None:
        sensor, reliable = qos.newest_of_sensor(), qos.newest_reliable()
        self._depth_in = self._subscription(Image, "depth/image_rect", self._on_depth, sensor)
        self._info_in = self._subscription(CameraInfo, "depth/camera_info", self._on_info, qos.newest_of_sensor())
        self._pose_in = self._subscription(PoseStamped, "camera_pose", self._on_camera_pose, qos.history_of_sensor())
        self._mesh_topic = self.resolve_topic_name("mesh")
        key = f"qos_overrides.{self._mesh_topic}.subscription.durability"
        self._mesh_durability_set = key in getattr(self, "_parameter_overrides", {})
        options = qos.overridable(durability=self._mesh_durability_set)
        callback = self._guarded(self._on_mesh)
        self._mesh_in = self.create_subscription(
            Mesh, "mesh", callback, reliable, raw=True, qos_overriding_options=options
        )

    def _subscription(self, kind: Any, topic: str, callback: Callable[..., None], profile: QoSProfile) -> Any:
        return self.create_subscription(
            kind, topic, self._guarded(callback), profile, qos_overriding_options=qos.overridable()
        )

    def _publisher(self, kind: Any, topic: str, profile: QoSProfile | None = None) -> Publisher:
        return self.create_publisher(
            kind, topic, profile or qos.newest_reliable(), qos_overriding_options=qos.overridable()
        )

    def _timer(self, period: float, callback: Callable[[], None]) -> Any:
        return self.create_timer(period, self._guarded(callback), clock=self._steady)

    def _topics(self) -> dict[str, str]:
        subscriptions = {"depth": self._depth_in, "info": self._info_in, "mesh": self._mesh_in, "pose": self._pose_in}
        return {name: subscription.topic_name for name, subscription in subscriptions.items()}

    def _label(self) -> str:
        return self.get_fully_qualified_name().lstrip("/")

    def _guarded(self, callback: Callable[..., None]) -> Callable[..., None]:
        """A callback that never raises, whatever the message: an exception out of a callback would end the spinning."""

        @functools.wraps(callback)
        def guarded(*arguments: Any) -> None:
            try:
                callback(*arguments)
            except StartupError:
                raise
            except Exception as error:
                self.note_fault(error)

        return guarded

    def _match_lights(self, settings: Settings) -> None:
        names = {light.name for light in settings.lights}
        for name in set(self._light_out) - names:
            self.destroy_publisher(self._light_out.pop(name))
        for name in sorted(names - set(self._light_out)):
            self._light_out[name] = self._publisher(Image, f"~/mask/{name}")

    def _match_publishers(self) -> None:
        """Give the mesh subscription the durability all publishers offer; look for publishers that cannot be heard."""
        publishers = self.get_publishers_info_by_topic(self._mesh_topic)
        profile = self._mesh_in.qos_profile
        wanted = qos.matching_durability(publishers)
        if wanted is not None and wanted != profile.durability and not self._mesh_durability_set:
            self.destroy_subscription(self._mesh_in)
            profile = qos.with_durability(profile, wanted)
            self._mesh_in = self.create_subscription(Mesh, "mesh", self._guarded(self._on_mesh), profile, raw=True)
        self._health.mesh_mismatch = qos.mismatch(
            publishers, self._mesh_topic, "shape_msgs/msg/Mesh", profile.reliability
        )
        topic, profile = self._health.topics["depth"], self._depth_in.qos_profile
        publishers = self.get_publishers_info_by_topic(topic)
        self._health.depth_mismatch = qos.mismatch(publishers, topic, "sensor_msgs/msg/Image", profile.reliability)

    # Inputs: callbacks only store; the work is done in one step afterwards

    def _on_depth(self, msg: Image, info: dict[str, Any]) -> None:
        start = time.perf_counter()
        now, stamp = time.monotonic(), stamp_ns(msg.header.stamp)
        self._health.depth.tick(now)
        number = info.get("publication_sequence_number") or 0
        if self._depth_in.get_publisher_count() == 1 and 0 < self._last_number < number:
            self._health.skipped += number - self._last_number - 1
        self._last_number = number
        try:
            depth = decode_depth(msg)
        except MessageError as error:
            self._health.depth_refused.add(str(error), now)
            return
        if stamp < self._last_stamp - _BACKWARD_STAMPS:
            self._forget(f"depth images start again {(self._last_stamp - stamp) * 1e-9:.1f} s earlier")
        self._last_stamp = stamp
        self._health.depth_format = f"{msg.encoding} {msg.width} x {msg.height}"
        self._queue.put(WaitingFrame(msg, depth, stamp, now, (time.perf_counter() - start) * 1e3))
        self._work.trigger()

    def _on_info(self, msg: CameraInfo) -> None:
        self._queue.put_info(msg)
        if len(self._queue):
            self._work.trigger()

    def _on_mesh(self, data: bytes) -> None:
        now_ns = self.get_clock().now().nanoseconds
        self._mesh.receive(data, self.settings.max_triangles, time.monotonic(), now_ns)

    def _on_camera_pose(self, msg: PoseStamped) -> None:
        fixed, frame = self.settings.fixed_frame, msg.header.frame_id
        try:
            if fixed and frame and frame != fixed:
                raise MessageError(f"header.frame_id: expected fixed_frame {fixed!r}, got {frame!r}")
            pose = pose_matrix(msg.pose, "pose")
        except MessageError as error:
            self._health.pose_refused.add(str(error), time.monotonic())
            return
        self._frames.camera_poses.add(stamp_ns(msg.header.stamp), pose)
        if len(self._queue):
            self._work.trigger()

    def _on_settings(self, old: Settings, new: Settings) -> None:
        try:
            self._match_lights(new)
            self._frames.configure(new)
            if (old.pipeline, old.variant) != (new.pipeline, new.variant):
                self._host.select(new)
            if old.diagnostics_period != new.diagnostics_period:
                self.destroy_timer(self._reporting)
                self._reporting = self._timer(new.diagnostics_period, self._report)
        except Exception as error:  # set_parameters must not raise into rclpy's service
            self.note_fault(error)

    def _on_jump(self, jump: Any) -> None:
        self._last_stamp = 0
        self._forget(f"time jumped back by {-jump.delta.nanoseconds * 1e-9:.1f} s")

    def _forget(self, why: str) -> None:
        self._health.time_jumps += 1
        self._queue.clear()
        self._frames.clear()
        self._mesh.restart_age(self.get_clock().now().nanoseconds)
        self.get_logger().info(f"{why}: waiting frames, poses and ages are cleared", throttle_duration_sec=1.0)

    # Work

    def _step(self) -> None:
        self._collect_tracer()
        tracer = self._host.tracer
        if tracer is None:
            self._queue.keep_newest()
            return
        answer = self._processor.step(self.settings, tracer, time.monotonic(), self.get_clock().now().nanoseconds)
        if answer is not None:
            self._publish(answer)
        if len(self._queue):
            self._retry.reset()
        else:
            self._retry.cancel()

    def _collect_tracer(self) -> None:
        result = self._host.collect()
        if result is None:
            return
        error, seconds = result
        device, tracer = self._health.device, self._host.made
        if tracer is None:
            raise StartupError(error)
        device.error, device.ready_after = error, seconds
        device.name, device.pipeline, device.variant = tracer.device, tracer.pipeline, tracer.variant
        if error:
            self.get_logger().error(f"{error}; pipeline {tracer.pipeline} stays in use")
        what = f"{tracer.pipeline}/{tracer.variant} on {tracer.device}"
        self.get_logger().info(f"Ready: {what}; compiling and loading kernels took {seconds:.1f} s")

    def _publish(self, answer: Answer) -> None:
        start = time.perf_counter()
        image = answer.frame.image
        for name, mask in answer.light_masks.items():
            self._publish_mask(self._light_out[name], mask, image)
        self._publish_mask(self._mask_out, answer.mask, image)
        if answer.info is not None:
            self._info_out.publish(answer.info)
        end = time.perf_counter()
        total = (time.monotonic() - answer.frame.arrived) * 1e3
        latency = (self.get_clock().now().nanoseconds - answer.frame.stamp) * 1e-6
        self._health.note(answer, total, latency)
        stages = answer.stages | {"publish": (end - start) * 1e3, "total": total}
        numbers = {"age at publication [ms]": f"{latency:.1f}", "width": image.width, "height": image.height}
        numbers |= answer.numbers | {"dropped": self._queue.dropped, "skipped before the node": self._health.skipped}
        device = self._health.device.name
        array = diagnostics.timing(self._label(), device, image.header.stamp, answer.missing, stages, numbers)
        self._timing_out.publish(array)
        if answer.missing is not None:
            self.get_logger().warning(f"mask unknown: {answer.missing.text}", throttle_duration_sec=5.0)

    def _report(self) -> None:
        busy = self._host.busy_for() if self._host.busy else None
        clock = self.get_clock().now()
        array = self._health.report(self.settings, busy, time.monotonic(), clock.nanoseconds, clock.to_msg())
        self._diagnostics_out.publish(array)

    @staticmethod
    def _publish_mask(publisher: Publisher, mask: Mask, image: Image) -> None:
        # Nobody can tell a mask nobody listens to from one that was not sent, unless it is kept for late joiners.
        if publisher.get_subscription_count() or publisher.qos_profile.durability != DurabilityPolicy.VOLATILE:
            publisher.publish(mask_image(mask, image))


def spin(node: ShadowNode, stop: Callable[[], bool]) -> int:
    """Run callbacks until ``stop()`` is true, which is asked after each, or the context is shut down.

    Returns:
        The exit code: 1 if the tracer could not be made.
    """
    executor = SingleThreadedExecutor(context=node.context)
    executor.add_node(node)
    faults = 0
    try:
        while not stop() and node.context.ok():
            try:
                executor.spin_once()
                faults = 0
            except ExternalShutdownException:
                break
            except StartupError as error:
                node.get_logger().error(f"the tracer cannot be made: {error}")
                return 1
            except Exception as error:  # rclpy's own services raise on malformed requests
                node.note_fault(error)
                faults += 1
                if faults == _TOO_MANY_FAULTS:
                    return 1
        return 0
    finally:
        executor.shutdown(timeout_sec=0.0)


if __name__ == "__main__":
    sys.exit(main())
