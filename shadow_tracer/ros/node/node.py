# SPDX-License-Identifier: Apache-2.0
"""The node ``shadow_tracer``, as the executable ``shadow_node`` runs it: it works from the moment it is made.

``main`` is the program; it lives in :mod:`process`, which imports this module once signals are under control.
"""

from __future__ import annotations

import gc
import sys
from collections.abc import Callable
from typing import Any

from rcl_interfaces.msg import SetParametersResult
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.node import Node
from rclpy.parameter import Parameter

from shadow_tracer.ros.node.core import Core, StartupError
from shadow_tracer.ros.node.process import main
from shadow_tracer.ros.parameters.parameter_rows import ParameterError
from shadow_tracer.ros.settings import Settings

NAME = "shadow_tracer"
_TOO_MANY_FAULTS = 100

__all__ = ["NAME", "ShadowNode", "ShadowNodeMixin", "StartupError", "main", "spin"]


class ShadowNodeMixin(Node):
    """What the plain and the managed node have in common; ``_core`` is made by them."""

    _core: Core | None = None

    @property
    def core(self) -> Core:
        """Everything behind the node."""
        if self._core is None:
            raise RuntimeError("core: the node is still being made")
        return self._core

    @property
    def settings(self) -> Settings:
        """The parameters, checked and converted."""
        return self.core.settings

    @property
    def ready(self) -> bool:
        """True once frames are traced; False while kernels are compiled."""
        return self.core.host.tracer is not None

    def set_parameters(self, parameter_list: list[Parameter]) -> list[SetParametersResult]:
        """As rclpy's, with refusals that say why."""
        return [self.set_parameters_atomically([parameter]) for parameter in parameter_list]

    def set_parameters_atomically(self, parameter_list: list[Parameter]) -> SetParametersResult:
        """As rclpy's, with refusals that say why."""
        reason = ""
        if self._core:
            try:
                parameter_list = self._core.server.renamed(parameter_list)
                reason = self._core.server.refusal(parameter_list)
            except ParameterError as error:
                reason = str(error)
        if reason:
            return SetParametersResult(successful=False, reason=reason)
        return super().set_parameters_atomically(parameter_list)

    def note_fault(self, error: Exception) -> None:
        """Count and log an exception that should not have happened; the node goes on."""
        self.core.note_fault(error)

    def close(self, timeout: float = 0.5) -> bool:
        """Destroy the node. False if the tracer's thread is still compiling after ``timeout`` seconds."""
        joined = self._core.close(timeout) if self._core else True
        self.destroy_node()
        return joined


class ShadowNode(ShadowNodeMixin):
    """Depth images, camera_info, meshes and poses in; masks, timing and diagnostics out.

    Args:
        kwargs: as for :class:`rclpy.node.Node`: ``context``, ``cli_args``, ``parameter_overrides``, ``namespace``.

    Raises:
        ParameterError: a parameter override is bad.
    """

    def __init__(self, **kwargs: Any) -> None:
        super().__init__(NAME, **kwargs)
        self._core = Core(self)
        self._core.activate()
        self._core.start()


def _spare_collector() -> None:
    """What is there when frames begin stays: the modules of Warp and ROS are some hundred thousand objects, and looking
    through them for garbage would hold up a frame for 50 ms now and then."""
    gc.collect()
    gc.freeze()


def spin(node: ShadowNodeMixin, stop: Callable[[], bool]) -> int:
    """Run callbacks until ``stop()`` is true, which is asked after each, or the context is shut down.

    Returns:
        The exit code: 1 if the tracer could not be made.
    """
    executor = SingleThreadedExecutor(context=node.context)
    executor.add_node(node)
    faults = 0
    settled = False
    try:
        while not stop() and node.context.ok():
            try:
                executor.spin_once()
                faults = 0
                if not settled and node.ready:
                    settled = True
                    _spare_collector()
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
