# SPDX-License-Identifier: Apache-2.0
"""The services ``~/clear_meshes`` and ``~/self_test``."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from diagnostic_msgs.msg import DiagnosticStatus, KeyValue
from diagnostic_msgs.srv import SelfTest
from rclpy.callback_groups import ReentrantCallbackGroup
from std_srvs.srv import Trigger

from shadow_tracer.ros.diagnostics import ERROR, OK
from shadow_tracer.ros.node.tracer_host import Outcome
from shadow_tracer.ros.node.turns import Turn

if TYPE_CHECKING:
    from shadow_tracer.ros.node.core import Core


class Services:
    """Answers the services of a node."""

    def __init__(self, core: Core) -> None:
        self._core = core
        core.node.create_service(Trigger, "~/clear_meshes", self._clear_meshes)
        core.node.create_service(SelfTest, "~/self_test", self._self_test, callback_group=ReentrantCallbackGroup())

    def _clear_meshes(self, _request: Any, response: Any) -> Any:
        try:
            count = self._core.inputs.meshes.clear(self._core.now_ns())
            response.success = True
            response.message = f"{count} parts cleared; those of mesh.files stay"
        except Exception as error:
            self._core.note_fault(error)
            response.success, response.message = False, str(error)
        return response

    async def _self_test(self, _request: Any, response: Any) -> Any:
        """Frames wait meanwhile: the device belongs to one at a time."""
        outcomes: list[Outcome] = []
        if self._core.host.made is None and not self._core.host.busy:
            outcomes.append(Outcome(None, "there is no tracer to test: configure the node first", 0.0))
        else:
            self._core.host.self_test(outcomes.append)
        while not outcomes and self._core.node.context.ok():
            await Turn()
        response.id = self._core.label
        if not outcomes:
            return response
        outcome = outcomes[0]
        name = f"{self._core.label}: self test"
        for result in outcome.value or ():
            level = OK if result.ok else ERROR
            values = [("pixels that differ", str(result.differing)), ("seconds", f"{result.seconds:.3f}")]
            pairs = [KeyValue(key=key, value=value) for key, value in values]
            text = result.text or ("same bits as brute_force" if result.ok else "differs from brute_force")
            what = f"{name}: {result.pipeline}/{result.variant}"
            response.status.append(
                DiagnosticStatus(level=level, name=what, message=text, hardware_id=self._core.label, values=pairs)
            )
        if outcome.error:
            response.status.append(
                DiagnosticStatus(level=ERROR, name=name, message=outcome.error, hardware_id=self._core.label)
            )
        passed = not outcome.error and all(result.ok for result in outcome.value or ())
        response.passed = b"\x01" if passed else b"\x00"
        return response
