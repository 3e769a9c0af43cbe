# SPDX-License-Identifier: Apache-2.0
"""The command line of the two nodes: ROS arguments and --help. rcl ignores everything else, here it is refused. No ROS
here."""

from __future__ import annotations

import shlex
import sys
from collections.abc import Sequence

_USAGE = """\
usage: {program} [--help] [--ros-args [-p NAME:=VALUE] [--params-file FILE] [-r FROM:=TO] ...]

{what}

  --ros-args           what follows is for ROS; ends at --
    -p NAME:=VALUE     set a parameter, such as occluders:=depth
    --params-file FILE set the parameters in a YAML file; config/default.yaml of the package has all of them
    -r FROM:=TO        give a topic another name, such as depth/image_rect:=/camera/depth/image_rect

example:
  {program} --ros-args --params-file my.yaml -r depth/image_rect:=/camera/depth/image_rect \\
      -r depth/camera_info:=/camera/depth/camera_info

Topics, parameters and exit codes: docs/node.md. If nothing comes out: shadow_tracer status."""

_WHAT = {
    "shadow_node": "Finds which pixels of a depth image each light reaches, and publishes masks.",
    "shadow_lifecycle_node": "The same as a managed node: ros2 lifecycle set /shadow_tracer configure, then activate.",
}
_FOR_ROS = ("-p", "-r", "-e", "--param", "--params-file", "--remap", "--log-level", "--log-config-file", "--enclave")


def answer(program: str, arguments: Sequence[str]) -> int | None:
    """Answer a command line with which the node is not to start.

    Args:
        program: ``shadow_node`` or ``shadow_lifecycle_node``.
        arguments: the command line without the program.

    Returns:
        The exit code: 0 after ``--help``, 2 after arguments that nobody would read. None: start.
    """
    stray = outside(arguments)
    if not stray:
        return None
    if stray[0] in ("-h", "--help"):
        print(usage(program))
        return 0
    hint = ""
    if stray[0].partition("=")[0] in _FOR_ROS or ":=" in stray[0]:
        hint = f"; for ROS it comes after --ros-args: {program} --ros-args {shlex.join(stray)}"
    names = " ".join(shlex.quote(word) for word in stray)
    print(f"{program}: expected nothing but --help and --ros-args ..., got {names}{hint}", file=sys.stderr)
    return 2


def usage(program: str) -> str:
    """What the program takes."""
    return _USAGE.format(program=program, what=_WHAT[program])


def outside(arguments: Sequence[str]) -> list[str]:
    """The words that are not for ROS: those before ``--ros-args`` and after the ``--`` that ends it, of each."""
    stray, for_ros = [], False
    for word in arguments:
        if word == "--ros-args":
            for_ros = True
        elif word == "--":
            for_ros = False
        elif not for_ros:
            stray.append(word)
    return stray
