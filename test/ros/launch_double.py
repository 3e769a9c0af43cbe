# SPDX-License-Identifier: Apache-2.0
"""A stand-in for the packages launch and launch_ros, which the wheels do not have: what our launch file uses, with the
signatures and checks of Jazzy. A keyword that Jazzy does not know is a TypeError here, too."""

from __future__ import annotations

import os
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from types import ModuleType
from typing import Any

_NODE_NAME = re.compile(r"[A-Za-z_][A-Za-z0-9_]*")
_NAMESPACE = re.compile(r"/?([A-Za-z_][A-Za-z0-9_]*(/[A-Za-z_][A-Za-z0-9_]*)*)?")


class LaunchContext:
    """Holds the launch configurations."""

    def __init__(self) -> None:
        self.launch_configurations: dict[str, str] = {}


class Action:
    """Something that a launch does."""

    def execute(self, context: LaunchContext) -> list[Action] | None:
        return None


class LaunchConfiguration:
    """The value of a launch argument."""

    def __init__(self, variable_name: str, *, default: str | None = None) -> None:
        self.variable_name, self.default = variable_name, default

    def perform(self, context: LaunchContext) -> str:
        found = context.launch_configurations.get(self.variable_name, self.default)
        if found is None:
            raise RuntimeError(f"launch configuration '{self.variable_name}' does not exist")
        return found


class DeclareLaunchArgument(Action):
    """An argument of the launch file."""

    def __init__(
        self,
        name: str,
        *,
        default_value: str | None = None,
        description: str | None = None,
        choices: Sequence[str] | None = None,
        condition: Any = None,
    ) -> None:
        assert all(isinstance(text, str) for text in (name, default_value or "", description or "", *(choices or ())))
        if choices is not None and default_value is not None and default_value not in choices:
            raise RuntimeError(f'Provided default_value "{default_value}" is not in provided choices "{choices}".')
        self.name, self.default_value, self.description, self.choices = name, default_value, description, choices

    def execute(self, context: LaunchContext) -> None:
        if self.name not in context.launch_configurations:
            if self.default_value is None:
                raise RuntimeError(f'Required launch argument "{self.name}" was not provided.')
            context.launch_configurations[self.name] = self.default_value
        value = context.launch_configurations[self.name]
        if self.choices is not None and value not in self.choices:
            raise RuntimeError(
                f'Argument "{self.name}" provided value "{value}" is not valid. Valid options are: {self.choices}'
            )


class OpaqueFunction(Action):
    """Calls a function with the context; what it returns is done next."""

    def __init__(
        self,
        *,
        function: Callable[..., list[Action] | None],
        args: Iterable[Any] | None = None,
        kwargs: Mapping[str, Any] | None = None,
    ) -> None:
        self._call = lambda context: function(context, *(args or ()), **(kwargs or {}))

    def execute(self, context: LaunchContext) -> list[Action] | None:
        return self._call(context)


class LaunchDescription:
    """What a launch file returns."""

    def __init__(self, initial_entities: Iterable[Action] | None = None) -> None:
        self.entities = list(initial_entities or ())


class Node(Action):
    """A process with a node. ``command`` and ``environment`` are what would be run."""

    def __init__(
        self,
        *,
        executable: str,
        package: str | None = None,
        name: str | None = None,
        namespace: str | None = None,
        exec_name: str | None = None,
        parameters: list[Any] | None = None,
        remappings: Iterable[tuple[str, str]] | None = None,
        ros_arguments: Iterable[str] | None = None,
        arguments: Iterable[str] | None = None,
        output: str = "log",
        emulate_tty: bool = False,
        env: Mapping[str, str] | None = None,
        additional_env: Mapping[str, str] | None = None,
        condition: Any = None,
        respawn: bool = False,
        respawn_delay: float | None = None,
        sigterm_timeout: Any = "5",
        sigkill_timeout: Any = "5",
        on_exit: Any = None,
    ) -> None:
        assert parameters is None or isinstance(parameters, list)
        assert output in ("screen", "log", "both", "own_log", "full")
        self.package, self.executable = package, executable
        self.name, self.namespace = name, namespace
        self.parameters = parameters or []
        self.remappings = list(remappings or ())
        self.ros_arguments, self.arguments = list(ros_arguments or ()), list(arguments or ())
        self.additional_env = dict(additional_env or {})
        assert all(isinstance(value, str) for pair in self.additional_env.items() for value in pair)

    def execute(self, context: LaunchContext) -> None:
        """Checks names as launch_ros does."""
        if self.name is not None and not _NODE_NAME.fullmatch(self.name):
            raise ValueError(f"Invalid node name: {self.name}")
        if self.namespace is not None and not _NAMESPACE.fullmatch(self.namespace):
            raise ValueError(f"Invalid namespace: {self.namespace}")

    def command_line(self) -> list[str]:
        """Arguments of the program, parameters of dictionaries as -p."""
        flags = [*self.arguments, "--ros-args", *self.ros_arguments]
        if self.name is not None:
            flags += ["-r", f"__node:={self.name}"]
        if self.namespace:
            flags += ["-r", f"__ns:=/{self.namespace.lstrip('/')}"]
        for item in self.parameters:
            if isinstance(item, dict):
                for name, value in item.items():
                    flags += ["-p", f"{name}:={str(value).lower() if isinstance(value, bool) else value}"]
            else:
                flags += ["--params-file", str(item)]
        return flags + [part for old, new in self.remappings for part in ("-r", f"{old}:={new}")]


class LifecycleNode(Node):
    """A process with a managed node, which is brought up if ``autostart``."""

    def __init__(self, *, name: str, namespace: str, autostart: bool = False, **kwargs: Any) -> None:
        assert isinstance(autostart, bool)
        super().__init__(name=name, namespace=namespace, **kwargs)
        self.autostart = autostart


class OldLifecycleNode(Node):
    """As it is before launch_ros 0.26.7: the keyword goes on to Node, which does not know it."""

    def __init__(self, *, name: str, namespace: str, **kwargs: Any) -> None:
        super().__init__(name=name, namespace=namespace, **kwargs)
        self.autostart = False


class ChangeState:
    """The event that asks a managed node for a transition."""

    def __init__(self, *, lifecycle_node_matcher: Callable[[Action], bool], transition_id: int) -> None:
        self.lifecycle_node_matcher, self.transition_id = lifecycle_node_matcher, transition_id


class EmitEvent(Action):
    """Emits an event."""

    def __init__(self, *, event: ChangeState) -> None:
        self.event = event


class OnStateTransition:
    """What is done when a managed node has changed its state."""

    def __init__(
        self,
        *,
        entities: list[Action],
        target_lifecycle_node: Node | None = None,
        transition: str | None = None,
        start_state: str | None = None,
        goal_state: str | None = None,
    ) -> None:
        assert not (transition and (start_state or goal_state))
        self.entities, self.target_lifecycle_node = entities, target_lifecycle_node
        self.start_state, self.goal_state = start_state, goal_state


class RegisterEventHandler(Action):
    """Sets a handler up."""

    def __init__(self, event_handler: OnStateTransition) -> None:
        self.event_handler = event_handler


def matches_action(target_action: Action) -> Callable[[Action], bool]:
    """A matcher of one action."""
    return lambda action: action is target_action


class Transition:
    """lifecycle_msgs/msg/Transition, for machines without ROS."""

    TRANSITION_CONFIGURE, TRANSITION_ACTIVATE = 1, 3


class PackageNotFoundError(KeyError):
    """No such package in the index."""


def get_package_prefix(package_name: str) -> str:
    """Where a package is installed, as ament_index_python looks it up."""
    for prefix in filter(None, os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep)):
        if Path(prefix, "share", "ament_index", "resource_index", "packages", package_name).is_file():
            return prefix
    raise PackageNotFoundError(package_name)


def modules(old: bool = False) -> dict[str, ModuleType]:
    """Modules to put into sys.modules.

    Args:
        old: those before launch_ros 0.26.7.
    """
    contents: dict[str, tuple[Any, ...]] = {
        "launch": (Action, LaunchContext, LaunchDescription),
        "launch.actions": (DeclareLaunchArgument, EmitEvent, OpaqueFunction, RegisterEventHandler),
        "launch.events": (matches_action,),
        "launch.substitutions": (LaunchConfiguration,),
        "launch_ros": (),
        "launch_ros.actions": (LifecycleNode, Node),
        "launch_ros.event_handlers": (OnStateTransition,),
        "launch_ros.events": (),
        "launch_ros.events.lifecycle": (ChangeState,),
        "ament_index_python": (),
        "ament_index_python.packages": (PackageNotFoundError, get_package_prefix),
        "lifecycle_msgs": (),
        "lifecycle_msgs.msg": (Transition,),
    }
    made = {name: ModuleType(name) for name in contents}
    for name, items in contents.items():
        vars(made[name]).update({item.__name__: item for item in items})
    if old:
        vars(made["launch_ros.actions"])["LifecycleNode"] = OldLifecycleNode
    return made


def run(description: LaunchDescription, **arguments: str) -> list[Node]:
    """Do what a launch with these arguments does, and return the processes it would start."""
    return [action for action in actions(description, **arguments) if isinstance(action, Node)]


def actions(description: LaunchDescription, **arguments: str) -> list[Action]:
    """The same, and return all that is done, in order."""
    context = LaunchContext()
    context.launch_configurations.update(arguments)
    waiting, done = list(description.entities), []
    while waiting:
        action = waiting.pop(0)
        waiting[:0] = action.execute(context) or []
        done.append(action)
    return done
