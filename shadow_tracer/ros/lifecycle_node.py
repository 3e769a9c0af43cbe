# SPDX-License-Identifier: Apache-2.0
"""The same node as a managed one, for stacks with a lifecycle manager; the executable ``shadow_lifecycle_node``.

unconfigured: parameters can be set, /diagnostics is published. configure: buffers are allocated and kernels loaded;
inactive listens to nothing. activate: as the plain node. cleanup frees the buffers.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from rclpy.lifecycle import LifecycleNode, LifecycleState, TransitionCallbackReturn

from shadow_tracer.ros.core import Core
from shadow_tracer.ros.node import NAME, ShadowNodeMixin

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
        LifecycleNode.__init__(self, NAME, **kwargs)
        self._core = Core(self, strict=False)

    def on_configure(self, _state: LifecycleState) -> TransitionCallbackReturn:
        """Make the tracer; returns when frames could be traced."""
        core = self.core
        core.start()
        while core.host.busy:
            if self._stop():
                return TransitionCallbackReturn.FAILURE
            core.host.join(_SLICE)
            core.host.collect()
        if core.startup_error:
            self.get_logger().error(f"the tracer cannot be made: {core.startup_error}")
            return TransitionCallbackReturn.FAILURE
        return TransitionCallbackReturn.SUCCESS

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
