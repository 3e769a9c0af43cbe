# SPDX-License-Identifier: Apache-2.0
"""check_node.py <prefix>: `ros2 run shadow_tracer shadow_node` for a package installed under this prefix, then SIGINT.

Run by the Python that holds ROS. The ros2 command is not on the package index, so this does what it does: find the
prefix in the ament index and start lib/<package>/<executable>. AMENT_PREFIX_PATH and PYTHONPATH are as the user has
them: unset after pip, set by setup.sh after colcon.
"""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import rclpy
from ament_index_python.packages import get_package_prefix, get_package_share_directory
from diagnostic_msgs.msg import DiagnosticArray

PACKAGE = "shadow_tracer"
START_LIMIT_S = 600.0  # the first start on a machine compiles the kernels


def find_executable(prefix: Path) -> Path:
    """The node under `prefix`, found through the ament index alone."""
    sourced = os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep)
    os.environ["AMENT_PREFIX_PATH"] = os.pathsep.join([*filter(None, sourced), sys.prefix])
    found = Path(get_package_prefix(PACKAGE))
    assert found.samefile(prefix), f"the index names {found}"
    share = Path(get_package_share_directory(PACKAGE))
    assert (share / "package.xml").is_file(), f"no package.xml in {share}"
    assert sorted((share / "config").glob("*.yaml")), f"no parameter files in {share / 'config'}"
    runnable = [path for path in (prefix / "lib" / PACKAGE).iterdir() if os.access(path, os.X_OK)]
    names = sorted(path.name for path in runnable)
    assert "shadow_node" in names, f"executables: {names}"
    print(f"index: {found}; executables: {', '.join(names)}")
    return prefix / "lib" / PACKAGE / "shadow_node"


def user_environment() -> dict[str, str]:
    """The variables of the shell: the library paths that the ROS wheels gave to this process are not among them."""
    ours = ("LD_LIBRARY_PATH", "_ROS_WHEELS_BOOTSTRAP_COMPLETE")
    return {key: value for key, value in os.environ.items() if key not in ours}


def wait_for_diagnostics(node_process: subprocess.Popen[bytes]) -> float:
    """Seconds until the node reports on /diagnostics."""
    heard: list[str] = []
    start = time.monotonic()
    rclpy.init()
    listener = rclpy.create_node("check_install")
    try:
        listener.create_subscription(
            DiagnosticArray, "/diagnostics", lambda message: heard.extend(status.name for status in message.status), 10
        )
        while not any(PACKAGE in name for name in heard):
            rclpy.spin_once(listener, timeout_sec=0.2)
            assert node_process.poll() is None, f"the node ended by itself with {node_process.returncode}"
            assert time.monotonic() - start < START_LIMIT_S, (
                f"nothing on /diagnostics for {START_LIMIT_S} s, only {heard}"
            )
    finally:
        listener.destroy_node()
        rclpy.try_shutdown()
    return time.monotonic() - start


def main() -> None:
    """Find, start, hear, stop."""
    prefix = Path(sys.argv[1])
    os.environ.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    os.environ.setdefault("ROS_DOMAIN_ID", str(os.getpid() % 101 + 1))
    # A shell without job control starts its children with SIGINT ignored, and they would hand that on.
    signal.signal(signal.SIGINT, signal.default_int_handler)
    command = [str(find_executable(prefix))]
    with tempfile.TemporaryFile("w+") as log:
        process = subprocess.Popen(command, env=user_environment(), stdout=log, stderr=log, start_new_session=True)
        try:
            seconds = wait_for_diagnostics(process)
            process.send_signal(signal.SIGINT)
            process.wait(timeout=30)
        finally:
            if process.poll() is None:
                os.killpg(process.pid, signal.SIGKILL)
            log.seek(0)
            output = log.read()
            print(output, end="")
    assert process.returncode == 0, f"SIGINT: exit status {process.returncode}"
    assert "Traceback" not in output, "the node printed a traceback"
    print(f"shadow_node spoke after {seconds:.1f} s and ended with 0 on SIGINT")


if __name__ == "__main__":
    main()
