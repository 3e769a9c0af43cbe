# SPDX-License-Identifier: Apache-2.0
"""Kills `shadow_tracer bags` at random moments and starts it again, until it is through; the output must have the bytes
of one uninterrupted run.

    python benchmark/bags_killed.py IN [--kills 50] [--frames 1] [options of shadow_tracer bags, such as --param]
"""

from __future__ import annotations

import argparse
import hashlib
import random
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from rosbags.highlevel import AnyReader

PROGRAM = (sys.executable, "-m", "shadow_tracer.apps.cli")


def digest(bag: Path) -> str:
    """Of topics, times and bytes of all messages."""
    found = hashlib.sha256()
    with AnyReader([bag]) as reader:
        for connection, when, data in reader.messages():
            found.update(f"{connection.topic} {when} {len(data)} ".encode())
            found.update(data)
    return found.hexdigest()


def main() -> int:
    """Returns 0 if the bytes are the same."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("bag", type=Path, metavar="IN")
    parser.add_argument("--kills", type=int, default=50)
    parser.add_argument("--frames", type=int, default=1)
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--longest", type=float, default=6.0, help="seconds until a run is killed, at most")
    parser.add_argument("--seed", type=int, default=1)
    chosen, options = parser.parse_known_args()
    chance = random.Random(chosen.seed)
    with tempfile.TemporaryDirectory() as folder:
        whole, out = Path(folder) / "whole.mcap", Path(folder) / "out"
        subprocess.run([*PROGRAM, "bag", str(chosen.bag), str(whole), "--no-timing", *options], check=True)
        command = [*PROGRAM, "bags", str(chosen.bag), str(out), "--no-timing", *options, "--log-json"]
        command += ["--frames", str(chosen.frames), "--jobs", str(chosen.jobs)]
        ended = 0
        for kill in range(chosen.kills):
            process = subprocess.Popen(command, stderr=subprocess.DEVNULL)
            time.sleep(chance.uniform(0.0, chosen.longest))
            if process.poll() is None:
                process.kill()
            ended += process.wait() == 0
            for part in out.glob("*/*.mcap"):  # some are lost, so that there is work for the next one
                if chance.random() < 0.3:
                    part.unlink()
            print(f"kill {kill + 1}: {len([*out.glob('*/*.mcap')])} parts", flush=True)
        subprocess.run(command, check=True, stderr=subprocess.DEVNULL)
        same = digest(whole) == digest(next(out.glob("*/metadata.yaml")).parent)
        left = [path.name for path in out.glob("*/.*")]
    print(f"{chosen.kills - ended} killed, {ended} came to their end; the bytes are {'the same' if same else 'OTHERS'}")
    print(f"left behind: {left or 'nothing'}")
    return 0 if same and not left else 1


if __name__ == "__main__":
    sys.exit(main())
