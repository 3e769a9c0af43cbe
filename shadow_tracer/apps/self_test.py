# SPDX-License-Identifier: Apache-2.0
"""`shadow_tracer self-test`: does every pipeline give the right bits on this machine? No ROS is needed."""

from __future__ import annotations

import argparse
import sys

from shadow_tracer import available_pipelines, self_test


def main(arguments: list[str] | None = None) -> int:
    """Entry point: 0 if every pipeline is right, 1 if one is not, 2 for a wrong option."""
    parser = argparse.ArgumentParser(
        prog="shadow_tracer self-test",
        description="Traces a small built-in scene on every pipeline and compares all bits with those that are right.",
    )
    parser.add_argument("--device", help="cpu or cuda:N (default: the first CUDA device, or the CPU)")
    parser.add_argument("--pipeline", action="append", choices=list(available_pipelines()),
                        help="only this one; may be repeated")  # fmt: skip
    chosen = parser.parse_args(arguments)
    try:
        results = self_test.run(
            chosen.device,
            chosen.pipeline,
            lambda name, done, count: print(f"{name} ({done + 1} of {count})", flush=True),
        )
    except (ValueError, ImportError, RuntimeError) as error:
        print(f"self-test: {error}", file=sys.stderr)
        return 1
    print()
    for result in results:
        verdict = "ok" if result.ok else f"WRONG: {result.text}"
        print(f"{result.pipeline}/{result.variant}: {verdict}, {result.seconds:.1f} s")
    return 0 if all(result.ok for result in results) else 1


if __name__ == "__main__":
    sys.exit(main())
