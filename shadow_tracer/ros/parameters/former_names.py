# SPDX-License-Identifier: Apache-2.0
"""Parameters that have had another name: a value under the former one is taken, with a warning. No ROS here."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from shadow_tracer.ros.parameters.parameter_rows import ParameterError

# former name -> name now, and why it had to change
FORMER = {
    "lights": ("light_names", "a list beside lights.<name>.* breaks `ros2 param dump` and nested YAML"),
}


def renamed(values: Mapping[str, Any]) -> tuple[dict[str, Any], list[str]]:
    """Values under the names of now, in the same order, and a warning for each that had a former one.

    Args:
        values: full parameter name -> value.

    Raises:
        ParameterError: both names are given, with different values.
    """
    given: dict[str, Any] = {}
    warnings = []
    for name, value in values.items():
        now, why = FORMER.get(name, (name, ""))
        if name != now:
            other = values.get(now, value)
            if _plain(other) != _plain(value):
                raise ParameterError(
                    f"{name}: expected only {now}, its name now, got {_yaml(value)} beside {now}: {_yaml(other)}"
                )
            warnings.append(f"{name} is called {now} now: write {now}: {_yaml(value)} ({why})")
        given[now] = value
    return given, warnings


def _plain(value: Any) -> Any:
    return list(value) if isinstance(value, (list, tuple)) else value


def _yaml(value: Any) -> str:
    if isinstance(value, (list, tuple)):
        return "[" + ", ".join(_yaml(item) for item in value) + "]"
    return str(value) if value != "" else '""'
