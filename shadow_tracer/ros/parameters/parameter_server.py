# SPDX-License-Identifier: Apache-2.0
"""The table of :mod:`parameters` on a ROS node: declared, validated, applied."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from typing import Any

from rcl_interfaces.msg import FloatingPointRange, IntegerRange, ParameterDescriptor, SetParametersResult
from rclpy.node import Node
from rclpy.parameter import Parameter

from shadow_tracer.ros.parameters import parameter_rows as rows
from shadow_tracer.ros.parameters import parameters as table
from shadow_tracer.ros.parameters.former_names import FORMER, renamed
from shadow_tracer.ros.settings import Settings

_TYPES = {
    rows.BOOL: Parameter.Type.BOOL,
    rows.INTEGER: Parameter.Type.INTEGER,
    rows.DOUBLE: Parameter.Type.DOUBLE,
    rows.STRING: Parameter.Type.STRING,
    rows.STRINGS: Parameter.Type.STRING_ARRAY,
    rows.DOUBLES: Parameter.Type.DOUBLE_ARRAY,
}


def _descriptor(row: table.Parameter) -> ParameterDescriptor:
    notes = [row.constraint, f"read-only: {row.read_only}" if row.read_only else ""]
    descriptor = ParameterDescriptor(
        description=row.description,
        additional_constraints="; ".join(note for note in notes if note),
        read_only=bool(row.read_only),
    )
    if row.slider is not None:
        low, high = row.slider
        if row.type == rows.INTEGER:
            descriptor.integer_range = [IntegerRange(from_value=int(low), to_value=int(high), step=0)]
        else:
            descriptor.floating_point_range = [FloatingPointRange(from_value=low, to_value=high, step=0.0)]
    return descriptor


def _plain(value: Any) -> Any:
    return list(value) if isinstance(value, tuple) else value


class ParameterServer:
    """Declares every parameter on a node and keeps the settings they amount to.

    Args:
        node: the node; its overrides (YAML, command line) are taken.
        on_change: called with the old and the new settings after they have changed.

    Raises:
        ParameterError: an override is bad; one line for each that is.
    """

    def __init__(self, node: Node, on_change: Callable[[Settings, Settings], None]) -> None:
        self._node = node
        self._on_change = on_change
        self._declaring = False
        # rclpy tells nobody about overrides that were not declared; only here can misspelt ones be found.
        overrides = getattr(node, "_parameter_overrides", {})
        given = {name: parameter.value for name, parameter in overrides.items()}
        self._overrides, self._renamed = renamed(given)
        problems = table.problems_in(self._overrides)
        if problems:
            raise table.ParameterError("\n".join(problems))
        self._declare(table.names_in(self._overrides))
        self.settings = table.settings_from(self._values())
        node.add_pre_set_parameters_callback(self._convert)
        node.add_on_set_parameters_callback(self._validate)
        node.add_post_set_parameters_callback(self._apply)

    def warnings(self) -> list[str]:
        """Overrides under a former name, and those that have no effect, each with the nearest name that would."""
        return self._renamed + self._unknown(self._overrides)

    def _unknown(self, names: Iterable[str]) -> list[str]:
        known = list(self._node.list_parameters([], 0).names)
        lights = [light.name for light in self.settings.lights]
        return table.unknown_names(names, known, lights, [camera.name for camera in self.settings.cameras])

    def renamed(self, parameters: Sequence[Parameter]) -> list[Parameter]:
        """The parameters under their names of now; what had a former one is logged.

        Raises:
            ParameterError: both names are given, with different values.
        """
        if not any(parameter.name in FORMER for parameter in parameters):
            return list(parameters)
        values, warnings = renamed({parameter.name: parameter.value for parameter in parameters})
        for warning in warnings:
            self._node.get_logger().warning(warning)
        return [Parameter(name, value=value) for name, value in values.items()]

    def refusal(self, parameters: Sequence[Parameter]) -> str:
        """Why these cannot be set whatever the others are, "" if they can: unknown, read-only, or not of its row (where
        rclpy would say only what type it expected, not of which parameter)."""
        for parameter in parameters:
            row = table.row_of(parameter.name)
            if not self._node.has_parameter(parameter.name):
                return "; ".join(self._unknown([parameter.name]))
            if row is not None and row.read_only:
                return f"{parameter.name} is read-only: {row.read_only}"
            try:
                if row is not None:
                    table.convert(parameter.name, row, parameter.value)
            except table.ParameterError as error:
                return str(error)
        return ""

    def _values(self) -> dict[str, Any]:
        names = [name for name in self._node.list_parameters([], 0).names if table.row_of(name)]
        return {name: self._node.get_parameter(name).value for name in names}

    def _declare(self, names: Sequence[str]) -> None:
        self._declaring = True
        try:
            for name in names:
                row = table.row_of(name)
                if row is None or self._node.has_parameter(name):
                    continue
                value = _plain(table.convert(name, row, self._overrides.get(name, row.default)))
                # An empty list has no element type; [''] is how ROS writes it.
                self._node.declare_parameter(
                    name, [""] if value == [] else value, _descriptor(row), ignore_override=True
                )
        finally:
            self._declaring = False

    def _convert(self, parameters: list[Parameter]) -> list[Parameter]:
        return [self._typed(parameter) for parameter in parameters]

    def _typed(self, parameter: Parameter) -> Parameter:
        row = table.row_of(parameter.name)
        if row is None:
            return parameter
        try:
            value = table.convert(parameter.name, row, parameter.value)
        except table.ParameterError:
            return parameter  # the validation that follows says why
        return Parameter(parameter.name, _TYPES[row.type], _plain(value))

    def _validate(self, parameters: list[Parameter]) -> SetParametersResult:
        if self._declaring:
            return SetParametersResult(successful=True)
        proposed = {parameter.name: parameter.value for parameter in parameters if table.row_of(parameter.name)}
        try:
            table.settings_from({**self._overrides, **self._values(), **proposed})
        except table.ParameterError as error:
            return SetParametersResult(successful=False, reason=str(error))
        return SetParametersResult(successful=True)

    def _apply(self, parameters: list[Parameter]) -> None:
        if self._declaring or not any(table.row_of(parameter.name) for parameter in parameters):
            return
        wanted = table.names_in(self._values())
        self._declare(wanted)
        for name in self._values():
            if name not in wanted:
                self._node.undeclare_parameter(name)
        old, self.settings = self.settings, table.settings_from(self._values())
        if old != self.settings:
            self._on_change(old, self.settings)
