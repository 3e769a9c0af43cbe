# SPDX-License-Identifier: Apache-2.0
"""What both executables are: parameters, inputs, work, outputs and diagnostics around a ROS node of either kind."""

from __future__ import annotations

import functools
import time
from collections.abc import Callable
from contextlib import suppress
from typing import Any

from rclpy.clock import Clock, ClockChange, ClockType, JumpThreshold
from rclpy.duration import Duration
from rclpy.node import Node

from shadow_tracer import ShadowTracer
from shadow_tracer.ros import diagnostics
from shadow_tracer.ros.cameras.fair_turns import FairTurns
from shadow_tracer.ros.node.answer import Answer
from shadow_tracer.ros.node.dose import DoseOutputs, DoseServices
from shadow_tracer.ros.node.ground import Ground
from shadow_tracer.ros.node.health import DeviceState, Health
from shadow_tracer.ros.node.inputs import Inputs
from shadow_tracer.ros.node.log_bridge import LogBridge
from shadow_tracer.ros.node.outputs import Outputs
from shadow_tracer.ros.node.processing import Processor
from shadow_tracer.ros.node.queries import Queries
from shadow_tracer.ros.node.services import Services
from shadow_tracer.ros.node.tracer_host import Outcome, TracerHost
from shadow_tracer.ros.parameters.parameter_server import ParameterServer
from shadow_tracer.ros.settings import Settings
from shadow_tracer.ros.world.exposure import LONGEST, Exposure
from shadow_tracer.ros.world.frames import Frames, Tf2
from shadow_tracer.ros.world.marker_feed import Markers
from shadow_tracer.ros.world.scene_markers import world_name

_RETRY_PERIOD = 0.01
_MATCH_PERIOD = 0.1
_MARK_PERIOD = 0.25  # how soon somebody who begins to listen gets markers
_TURN_PERIOD = 0.002  # between two pieces of drawing them
MATCH_PERIOD = _MATCH_PERIOD  # also the longest time a signal goes unnoticed


class StartupError(RuntimeError):
    """The tracer cannot be made: the node has no purpose and ends with exit code 1."""


class Core:
    """The node without its kind: works on any :class:`rclpy.node.Node` whose parameters it has declared.

    Args:
        node: the node, just made.
        strict: a tracer that cannot be made raises StartupError out of the executor; else it is only reported.

    Raises:
        ParameterError: a parameter override is bad.
    """

    def __init__(self, node: Node, strict: bool = True) -> None:
        self.node = node
        self.server = server = ParameterServer(node, self._on_settings)
        self.startup_error = ""
        self._strict = strict
        self._steady = Clock(clock_type=ClockType.STEADY_TIME)
        self.inputs = Inputs(node, self.guarded, lambda: server.settings, self._step, self._forget)
        self.frames = Frames(lambda: Tf2(node))
        self.queries = Queries(self.frames, self.inputs.meshes.store, self.inputs.lighting)
        self.inputs.connect(self.frames, self.queries)
        world = self.frames, self.inputs.meshes.store, self.inputs.lighting
        self.processors = {name: Processor(camera.queue, *world) for name, camera in self.inputs.cameras.items()}
        self._turns = FairTurns(self.processors)
        self.host = TracerHost(self.wake)
        self.outputs = Outputs(node, self.inputs.cameras)
        self.exposure, self.dose = Exposure(), DoseOutputs(node)
        self.markers = Markers(
            self.outputs.scene_markers, self.outputs.light_markers, self.inputs.meshes.store, self.inputs.lighting,
            lambda text: node.get_logger().warning(text, throttle_duration_sec=60.0),
        )  # fmt: skip
        self.ground = Ground(
            self.frames, self.inputs.meshes.store, self.inputs.lighting, self.outputs.shadow_grid, self.outputs.sun_map
        )
        self.health = Health(
            self.label, self.inputs, self.frames, self.processors, self.queries, self.exposure, self.ground
        )
        self._services = Services(self), DoseServices(self)
        self._guard = node.create_guard_condition(self.guarded(self._step))
        self._retry = self._timer(_RETRY_PERIOD, self._step)
        self._retry.cancel()
        self._matching = self._timer(_MATCH_PERIOD, self.inputs.match)
        self._marking = self._timer(_MARK_PERIOD, self._mark)
        self._drawing = self._timer(_TURN_PERIOD, self._mark)
        self._drawing.cancel()
        self._reporting = self._timer(server.settings.diagnostics_period, self._report)
        backward = JumpThreshold(min_forward=None, min_backward=Duration(nanoseconds=-1), on_clock_change=True)
        self._jumps = node.get_clock().create_jump_callback(backward, post_callback=self.guarded(self._on_jump))
        self._warned = False
        self._log = LogBridge(log := node.get_logger())
        # A logger for each: of one, a camera would take the turns of another.
        self._loggers = {name: log.get_child(name) if name else log for name in self.inputs.cameras}
        self.outputs.configure(server.settings)

    @property
    def settings(self) -> Settings:
        """The parameters, checked and converted."""
        return self.server.settings

    @property
    def label(self) -> str:
        """Name of the node with its namespace, as diagnostics call it."""
        return str(self.node.get_fully_qualified_name()).lstrip("/")

    def start(self) -> None:
        """Begin to make the tracer: buffers are allocated and kernels loaded, in a thread."""
        self.node.get_logger().info("starting up: kernels are compiled the first time, which can take a minute")
        self.startup_error = ""
        self.host.start(self.settings, self._on_started)

    def activate(self) -> None:
        """Begin to listen."""
        settings = self.settings
        self.frames.configure(settings)
        self.inputs.subscribe()
        self._load_files(settings)
        if not self._warned:  # not before all QoS overrides are declared
            self._warned = True
            for warning in self.server.warnings():
                self.node.get_logger().warning(warning)

    def deactivate(self) -> None:
        """Listen no more; meshes that were received stay, what waits is dropped."""
        self.inputs.unsubscribe()
        self.frames.close()
        for camera in self.inputs.cameras.values():
            camera.queue.clear()
        self.queries.clear()
        self.exposure.pause()

    def release(self) -> None:
        """Free the tracer and forget the meshes."""
        self.host.release()
        self.exposure.release()
        self.health.device = DeviceState()
        self.inputs.meshes.clear(self.now_ns())

    def close(self, timeout: float) -> bool:
        """Before the node is destroyed. False if the tracer's thread is still compiling after ``timeout`` seconds."""
        self._jumps.unregister()
        self._log.close()
        return self.host.join(timeout)

    def now_ns(self) -> int:
        """Time of the node's clock [ns]."""
        return int(self.node.get_clock().now().nanoseconds)

    def wake(self) -> None:
        """Make a spinning executor come back; may be called from any thread, also after the node was destroyed."""
        with suppress(Exception):
            self._guard.trigger()

    def note_fault(self, error: Exception) -> None:
        """Count and log an exception that should not have happened; the node goes on."""
        text = f"{type(error).__name__}: {error}"
        self.health.faults.add(text, time.monotonic())
        self.node.get_logger().error(text, throttle_duration_sec=5.0)

    def guarded(self, callback: Callable[..., None]) -> Callable[..., None]:
        """A callback that never raises, whatever the message: an exception out of a callback would end the spinning."""

        @functools.wraps(callback, assigned=())
        def guarded(*arguments: Any) -> None:
            try:
                callback(*arguments)
            except StartupError:
                raise
            except Exception as error:
                self.note_fault(error)

        return guarded

    def _timer(self, period: float, callback: Callable[[], None]) -> Any:
        return self.node.create_timer(period, self.guarded(callback), clock=self._steady)

    # Changes

    def _on_settings(self, old: Settings, new: Settings) -> None:
        try:
            self.outputs.configure(new)
            self.inputs.configure(new)
            self.inputs.lighting.configure(old, new)
            self.exposure.configure(old, new)
            if self.inputs.subscriptions:  # else the node is not active and listens to nothing, not to tf either
                self.frames.configure(new)
            if (old.mesh_files, old.mesh_files_scale) != (new.mesh_files, new.mesh_files_scale):
                self._load_files(new)
            if (old.pipeline, old.variant) != (new.pipeline, new.variant):
                self.host.select(new, self._on_selected)
            elif bool(old.verify_every) != bool(new.verify_every):
                self.host.verify(bool(new.verify_every), self._on_selected)
            if old.diagnostics_period != new.diagnostics_period:
                self.node.destroy_timer(self._reporting)
                self._reporting = self._timer(new.diagnostics_period, self._report)
        except Exception as error:  # set_parameters must not raise into rclpy's service
            self.note_fault(error)

    def _load_files(self, settings: Settings) -> None:
        self.inputs.meshes.load_files(settings, self.now_ns())
        for text in self.inputs.meshes.left_out:
            self.node.get_logger().warning(text)

    def _on_jump(self, jump: Any) -> None:
        if jump.clock_change in (ClockChange.ROS_TIME_ACTIVATED, ClockChange.ROS_TIME_DEACTIVATED):
            self._forget("use_sim_time has changed")
            return
        self._forget(f"time jumped back by {-jump.delta.nanoseconds * 1e-9:.1f} s")

    def _forget(self, why: str) -> None:
        self.health.time_jumps += 1
        self.inputs.restart(self.now_ns())
        self.frames.clear()
        self.exposure.pause()
        self.node.get_logger().info(f"{why}: what waited, poses and ages are cleared", throttle_duration_sec=1.0)

    def _on_started(self, outcome: Outcome) -> None:
        if self.host.made is None:
            self.startup_error = outcome.error
            self.health.device.error = outcome.error
            if self._strict:
                raise StartupError(outcome.error)
            return
        self._on_selected(outcome)

    def _on_selected(self, outcome: Outcome) -> None:
        device, tracer = self.health.device, self.host.made
        if tracer is None:
            return
        device.error, device.ready_after = outcome.error, outcome.seconds
        device.name, device.pipeline, device.variant = tracer.device, tracer.pipeline, tracer.variant
        device.reserved, device.threads = tracer.device_bytes, tracer.threads
        logger = self.node.get_logger()
        if outcome.error:
            logger.error(f"{outcome.error}; pipeline {tracer.pipeline} stays in use")
        what = f"{tracer.pipeline}/{tracer.variant} on {tracer.device}"
        logger.info(f"Ready: {what}; compiling and loading kernels took {outcome.seconds:.1f} s")

    def _on_cones(self, outcome: Outcome) -> None:
        if outcome.error:
            self.node.get_logger().error(f"kernels for cones: {outcome.error}")
        elif self.host.made is not None:
            self.health.device.reserved = self.host.made.device_bytes

    # Work

    def _step(self) -> None:
        self.host.collect()
        tracer = self.host.tracer
        if tracer is None:
            self.inputs.keep_newest()
            return
        settings = self.settings
        camera, answer = self._next_answer(settings, tracer)
        if answer is not None:
            self._publish(camera, answer, settings.of(camera))
            self._expose(answer, settings, tracer)
            self._note_choice(tracer.choice)
        if self.queries.about_cones and not self.host.ready_for_cones:  # they wait, frames do not wait longer
            self.host.prepare_cones(self._on_cones)
            return
        self.queries.step(
            settings, tracer, self.inputs.camera_frame, time.monotonic(), self.now_ns(), self.outputs.visibility.publish
        )
        if answer is not None and self.inputs.waiting:
            self.wake()  # with process: every, or of another camera, the next one may be complete
        if self.inputs.waiting or len(self.queries):
            self._retry.reset()
        else:
            self._retry.cancel()

    def _next_answer(self, settings: Settings, tracer: ShadowTracer) -> tuple[str, Answer | None]:
        """The answer to an image of the camera whose turn it is, and which camera that is; None if all wait."""
        now, now_ns = time.monotonic(), self.now_ns()
        for camera in self._turns.order():
            answer = self.processors[camera].step(settings.of(camera), tracer, now, now_ns)
            if answer is not None:
                self._turns.answered(camera)
                return camera, answer
        return "", None

    def _expose(self, answer: Answer, settings: Settings, tracer: ShadowTracer) -> None:
        """Count the time since the last image, if everything is known of both."""
        if answer.missing is not None:
            if not self.health.any_known(time.monotonic(), LONGEST):  # of another camera's images everything is known
                self.exposure.pause()
            return
        lights = answer.traced.lights if answer.traced is not None else ()
        if self.exposure.note(settings, tracer, lights, self.now_ns()):
            self.show_dose(answer.frame.image.header.stamp)
            if self.exposure.trouble:  # diagnostics have that of the last exposure alone
                self.node.get_logger().warning(self.exposure.trouble, throttle_duration_sec=5.0)

    def show_dose(self, stamp: Any = None) -> None:
        """Publish what parts have received; ``stamp``: None is now."""
        world = world_name(self.settings, self.inputs.camera_frame)
        stamp = self.node.get_clock().now().to_msg() if stamp is None else stamp
        self.dose.publish(self.exposure, self.settings, stamp, world)

    def _note_choice(self, choice: str) -> None:
        """Log when pipeline auto has changed its mind."""
        device = self.health.device
        before, device.choice = device.choice, choice
        if choice.partition(":")[0] != before.partition(":")[0]:
            self.node.get_logger().info(f"pipeline auto chooses {choice}", throttle_duration_sec=1.0)

    def _publish(self, camera: str, answer: Answer, settings: Settings) -> None:
        image, inputs, outputs = answer.frame.image, self.inputs.cameras[camera], self.outputs.cameras[camera]
        stages = answer.stages | outputs.publish(answer, settings)
        total = (time.monotonic() - answer.frame.arrived) * 1e3
        latency = diagnostics.age_ms(answer.frame.stamp, self.now_ns())
        self.health.cameras[camera].note(answer, total, latency, time.monotonic())
        stages["total"] = total
        numbers = {
            "age at publication [ms]": "-" if latency is None else f"{latency:.1f}",
            "width": image.width,
            "height": image.height,
        }
        numbers |= answer.numbers
        numbers |= {"dropped": inputs.queue.dropped, "skipped before the node": inputs.losses.skipped}
        device = self.health.device.name
        name = f"{self.label}/{camera}" if camera else self.label
        array = diagnostics.timing(name, device, image.header.stamp, answer.missing, stages, numbers)
        outputs.timing.publish(array)
        if answer.missing is not None:
            self._loggers[camera].warning(f"mask unknown: {answer.missing.text}", throttle_duration_sec=5.0)

    def _mark(self) -> None:
        inputs, tracer, now = self.inputs, self.host.tracer, time.monotonic()
        self.dose.mark(self.exposure, self.settings, world_name(self.settings, inputs.camera_frame), now)
        seen = (inputs.camera_frame, inputs.last_stamp, now, self.now_ns())
        more = self.markers.step(self.settings, *seen)
        if tracer is not None:
            more = self.ground.step(self.settings, tracer, *seen) or more
        if more:  # the rest between other work: frames must not wait for it
            if self._drawing.is_canceled():
                self._drawing.reset()
        else:
            self._drawing.cancel()

    def _report(self) -> None:
        clock = self.node.get_clock().now()
        doing = (self.host.doing, self.host.busy_for()) if self.host.busy else None
        array = self.health.report(self.settings, doing, time.monotonic(), clock.nanoseconds, clock.to_msg())
        self.outputs.diagnostics.publish(array)
