# SPDX-License-Identifier: Apache-2.0
"""The same node as a managed one, for stacks with a lifecycle manager; the executable ``shadow_lifecycle_node``.

unconfigured: parameters can be set, /diagnostics is published. configure: buffers are allocated and kernels loaded,
which can take a minute, while the node answers as before; inactive listens to nothing. activate: as the plain node.
cleanup frees the buffers.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from lifecycle_msgs.msg import State, Transition
from lifecycle_msgs.srv import ChangeState
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.lifecycle import LifecycleNode, LifecycleNodeMixin, LifecycleState, TransitionCallbackReturn
from rclpy.node import Node

from shadow_tracer.ros.node.core import Core
from shadow_tracer.ros.node.node import NAME, ShadowNodeMixin
from shadow_tracer.ros.node.turns import Turn

_SLICE = 0.05


class ShadowLifecycleNode(ShadowNodeMixin, LifecycleNode):
    """The managed node.

    Args:
        stop: asked while kernels are loaded; true gives up.
        kwargs: as for :class:`rclpy.node.Node`.

    Raises:
        ParameterError: a parameter override is bad.
    """

    def __init__(self, stop: Callable[[], bool] = lambda: False, **kwargs: Any) -> None:
        self._stop = stop
        Node.__init__(self, NAME, **kwargs)
        LifecycleNodeMixin.__init__(self, callback_group=ReentrantCallbackGroup())
        service: Any = next(service for service in self.services if service.srv_type is ChangeState)
        self._change_state, service.callback = service.callback, self._on_change_state
        self._core = Core(self, strict=False)

    async def _on_change_state(self, request: Any, response: Any) -> Any:
        """Answer a wish for a transition. rclpy would do all of it in one callback: while kernels are compiled nobody
        would get parameters, the state or diagnostics; and it has no answer to a transition that there is not."""
        machine = self._state_machine
        try:
            label = request.transition.label
            wanted = machine.get_transition_by_label(label) if label else request.transition.id
            if wanted != Transition.TRANSITION_CONFIGURE:
                return self._change_state(request, response)
            machine.trigger_transition_by_id(wanted, True)
        except RuntimeError as error:  # rcl's: no such transition, or not from here
            self.get_logger().warning(f"transition refused in state {machine.current_state[1]!r}: {error}")
            response.success = False
            return response
        try:
            result = await self._configured()
        except Exception as error:
            self.note_fault(error)
            result = TransitionCallbackReturn.ERROR
        machine.trigger_transition_by_label(result.to_label(), True)
        if result == TransitionCallbackReturn.ERROR:
            before = LifecycleState(state_id=State.PRIMARY_STATE_UNCONFIGURED, label="unconfigured")
            machine.trigger_transition_by_label(self.on_error(before).to_label(), True)
        response.success = result == TransitionCallbackReturn.SUCCESS
        return response

    async def _configured(self) -> TransitionCallbackReturn:
        """As :meth:`on_configure`, between the other work of the executor."""
        core = self.core
        core.start()
        while core.host.doing == "start":
            if self._stop():
                return TransitionCallbackReturn.FAILURE
            await Turn()
        return self._made()

    def _made(self) -> TransitionCallbackReturn:
        if self.core.startup_error:
            self.get_logger().error(f"the tracer cannot be made: {self.core.startup_error}")
            return TransitionCallbackReturn.FAILURE
        return TransitionCallbackReturn.SUCCESS

    def on_configure(self, _state: LifecycleState) -> TransitionCallbackReturn:
        """Make the tracer; returns when frames could be traced. Called by ``trigger_configure``; a request by a service
        does not hold up the executor."""
        core = self.core
        core.start()
        while core.host.busy:
            if self._stop():
                return TransitionCallbackReturn.FAILURE
            core.host.join(_SLICE)
            core.host.collect()
        return self._made()

    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Listen and answer."""
        self.core.activate()
        return super().on_activate(state)

    def on_deactivate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Listen to nothing; meshes stay."""
        self.core.deactivate()
        return super().on_deactivate(state)

    def on_cleanup(self, _state: LifecycleState) -> TransitionCallbackReturn:
        """Free buffers and forget meshes."""
        return self._release()

    def on_shutdown(self, _state: LifecycleState) -> TransitionCallbackReturn:
        """The same from any state."""
        self.core.deactivate()
        return self._release()

    def on_error(self, _state: LifecycleState) -> TransitionCallbackReturn:
        """Back to unconfigured after a transition raised."""
        self.core.deactivate()
        return self._release()

    def _release(self) -> TransitionCallbackReturn:
        if self.core.host.busy:
            self.get_logger().error(f"cannot clean up now: {self.core.host.doing} is running; try again")
            return TransitionCallbackReturn.FAILURE
        self.core.release()
        return TransitionCallbackReturn.SUCCESS
