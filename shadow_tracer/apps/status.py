# SPDX-License-Identifier: Apache-2.0
"""`shadow_tracer status`: what the node says of itself on /diagnostics, a line for people each."""

from __future__ import annotations

import argparse
import importlib.util
import sys
import time
from typing import Any

_WORDS = {b"\x00": "OK", b"\x01": "WARN", b"\x02": "ERROR", b"\x03": "STALE"}
_LAST = ("input mesh", "transforms", "device", "processing")  # after one or more about depth images
_NO_NODE = (
    "no node: nothing came within {:g} s; is shadow_node running, with the same ROS_DOMAIN_ID and "
    "ROS_AUTOMATIC_DISCOVERY_RANGE?"
)

_DESCRIPTION = """\
Listens to /diagnostics and prints the statuses of the node, each with what helps. Exit code 0 if none of them is
an ERROR, 1 if one is or there is no node, 2 for a wrong option or without ROS."""


def node_of(array: Any) -> str:
    """Name of the shadow_tracer node that a message of /diagnostics comes from; "" if it is from another program."""
    names = [status.name.rpartition(": ") for status in array.status]
    nodes = {node for node, _, what in names}
    statuses = tuple(what for _, _, what in names)
    cameras = statuses[: -len(_LAST)]
    images = bool(cameras) and all(what.startswith("input depth") for what in cameras)
    ours = images and statuses[-len(_LAST) :] == _LAST
    return nodes.pop() if len(nodes) == 1 and ours else ""


def lines(array: Any, verbose: bool = False) -> list[str]:
    """The statuses of a message as text, one line each.

    Args:
        verbose: the numbers behind each follow it, a line for each.
    """
    text = []
    width = max([11, *(len(status.name.rpartition(": ")[2]) for status in array.status)])
    for status in array.status:
        what = status.name.rpartition(": ")[2]
        text.append(f"{_WORDS.get(status.level, '?'):5} {what:{width}} {status.message}")
        if verbose:
            text += [f"{'':{width + 6}} {pair.key}: {pair.value}" for pair in status.values]
    return text


def failed(array: Any) -> bool:
    """Whether one of the statuses is worse than a warning."""
    return any(status.level not in (b"\x00", b"\x01") for status in array.status)


def listen(node: str, timeout: float) -> tuple[Any | None, set[str]]:
    """The next message of a node.

    Args:
        node: its name with its namespace, without the leading slash; "" is the first that is heard.
        timeout: seconds after which to give up.

    Returns:
        The message, None if there was none; and the names of all shadow_tracer nodes that were heard.
    """
    import rclpy
    from diagnostic_msgs.msg import DiagnosticArray
    from rclpy.executors import SingleThreadedExecutor
    from rclpy.node import Node
    from rclpy.qos import QoSProfile, ReliabilityPolicy

    context = rclpy.Context()
    rclpy.init(context=context, args=[])
    found: dict[str, Any] = {}

    def note(array: Any) -> None:
        if name := node_of(array):
            found.setdefault(name, array)

    friend = Node("shadow_tracer_status", context=context)
    executor = SingleThreadedExecutor(context=context)
    executor.add_node(friend)
    try:
        # Best effort hears every publisher of other programs on the topic, too.
        profile = QoSProfile(depth=100, reliability=ReliabilityPolicy.BEST_EFFORT)
        friend.create_subscription(DiagnosticArray, "/diagnostics", note, profile)
        deadline = time.monotonic() + timeout
        while not (node in found if node else found) and time.monotonic() < deadline:
            executor.spin_once(timeout_sec=0.05)
    finally:
        executor.shutdown(timeout_sec=0.0)
        friend.destroy_node()
        rclpy.shutdown(context=context)
    return found.get(node or next(iter(found), "")), set(found)


def _seconds(text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = 0.0
    if not 0.0 < value <= 3600.0:  # NaN is not either
        raise argparse.ArgumentTypeError(f"expected more than 0 and at most 3600 seconds, got {text!r}")
    return value


def _options() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="shadow_tracer status", description=_DESCRIPTION, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "--node",
        default="",
        metavar="NAME",
        help="full name of the node, such as /front/shadow_tracer (default: the first that is heard)",
    )
    parser.add_argument(
        "--timeout",
        type=_seconds,
        default=5.0,
        metavar="SECONDS",
        help="how long to wait for it, up to 3600 (default: %(default)g)",
    )
    parser.add_argument("-v", "--verbose", action="store_true", help="print the numbers behind each status, too")
    return parser


def main(arguments: list[str] | None = None) -> int:
    """Entry point: 0 if no status is an ERROR, 1 if one is or there is no node, 2 for a wrong option or without ROS,
    130 if interrupted."""
    chosen = _options().parse_args(arguments)
    if any(importlib.util.find_spec(name) is None for name in ("rclpy", "diagnostic_msgs")):
        print("status: needs ROS 2: source its setup.bash, or pip install 'shadow_tracer[ros]'", file=sys.stderr)
        return 2
    wanted = chosen.node.strip("/")
    try:
        array, heard = listen(wanted, chosen.timeout)
    except KeyboardInterrupt:
        return 130
    if array is None:
        others = f"; heard: {', '.join(sorted(heard))}" if heard else ""
        print(f"status: {_NO_NODE.format(chosen.timeout)}{others}", file=sys.stderr)
        return 1
    print(f"{node_of(array)}")
    print("\n".join(lines(array, chosen.verbose)))
    return int(failed(array))


if __name__ == "__main__":
    sys.exit(main())
