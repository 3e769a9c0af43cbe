# SPDX-License-Identifier: Apache-2.0
"""Makes docs/images/uv.gif: the animation of `shadow_tracer demo --uv`, small enough for a page."""

from __future__ import annotations

import argparse
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

from report import ROOT

_DEMO = ("-m", "shadow_tracer.apps.demo.demo", "--uv", "--animation-height", "330", "--device", "cpu")


def main() -> None:
    """Make it."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, default=ROOT / "docs" / "images", help="folder")
    animation = parser.parse_args().out / "uv.gif"
    with tempfile.TemporaryDirectory() as folder:
        subprocess.run([sys.executable, *_DEMO, "--output", folder], check=True)
        shutil.copyfile(Path(folder) / "uv.gif", animation)
    print(animation, animation.stat().st_size)


if __name__ == "__main__":
    main()
