# SPDX-License-Identifier: Apache-2.0
"""How long importing, the first start and a second start take, each in processes of their own."""

from __future__ import annotations

import argparse
import importlib.util
import os
import subprocess
import sys
import tempfile
import time

from report import ROOT, finish, summary

IMPORT = "import shadow_tracer"
TRACER = "import shadow_tracer; shadow_tracer.ShadowTracer().warm_up()"


def _run(code: str, cache: str) -> float:
    environment = {**os.environ, "WARP_CACHE_PATH": cache, "PYTHONPATH": str(ROOT)}
    begin = time.perf_counter()
    subprocess.run([sys.executable, "-c", code], env=environment, check=True, capture_output=True)
    return time.perf_counter() - begin


def _node(cache: str, domain: int) -> float:
    """Seconds from starting the node's process to its line saying that it is ready."""
    environment = {
        **os.environ,
        "WARP_CACHE_PATH": cache,
        "PYTHONPATH": str(ROOT),
        "PYTHONUNBUFFERED": "1",
        "ROS_DOMAIN_ID": str(domain),
        "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST",
        "ROS_LOG_DIR": cache,
        "RCUTILS_LOGGING_BUFFERED_STREAM": "0",
    }
    begin = time.perf_counter()
    process = subprocess.Popen(
        [sys.executable, "-m", "shadow_tracer.ros.node.node"], env=environment, stdout=subprocess.PIPE, text=True
    )
    assert process.stdout is not None
    try:
        for line in process.stdout:
            if "Ready" in line:
                return time.perf_counter() - begin
        raise RuntimeError("the node ended without becoming ready")
    finally:
        process.terminate()
        process.wait(30)


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--repeat", type=int, default=5, help="runs of what is quick")
    parser.add_argument("--domain", type=int, default=57, help="ROS_DOMAIN_ID")
    parser.add_argument("--json", help="file to write")
    options = parser.parse_args()
    rows = []
    with tempfile.TemporaryDirectory() as library, tempfile.TemporaryDirectory() as node:
        rows.append(
            {"what": "import shadow_tracer [s]", **summary([_run(IMPORT, library) for _ in range(options.repeat)])}
        )
        rows.append({"what": "bare interpreter [s]", **summary([_run("pass", library) for _ in range(options.repeat)])})
        rows.append({"what": "first tracer, kernels compiled [s]", **summary([_run(TRACER, library)])})
        rows.append({"what": "second tracer [s]", **summary([_run(TRACER, library) for _ in range(options.repeat)])})
        if importlib.util.find_spec("rclpy"):
            rows.append({"what": "first start of the node until Ready [s]", **summary([_node(node, options.domain)])})
            again = [_node(node, options.domain) for _ in range(options.repeat)]
            rows.append({"what": "second start of the node until Ready [s]", **summary(again)})
        else:
            print("skipped without rclpy: the node's starts")
    finish("Start", rows, options.json)


if __name__ == "__main__":
    main()
