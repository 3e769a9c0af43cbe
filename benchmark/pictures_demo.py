# SPDX-License-Identifier: Apache-2.0
"""Makes docs/images/workshop.gif and workshop.jpg: the demo's animation and its contact sheet, small enough for a page.

The demo is played through the node, as by `make demo`; no frame is left out, however slow the machine.
"""

from __future__ import annotations

import argparse
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

from PIL import Image
from report import ROOT

_DEMO = ("-m", "shadow_tracer.apps.demo.demo", "--node", "--animation-height", "270", "--frames", "32", "--budget", "0")
_WIDTH, _QUALITY = 1000, 85


def shrink(sheet: Image.Image) -> Image.Image:
    """A contact sheet in the size of a page."""
    size = _WIDTH, round(sheet.height * _WIDTH / sheet.width)
    return sheet.convert("RGB").resize(size, Image.Resampling.LANCZOS)


def main() -> None:
    """Make both."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, default=ROOT / "docs" / "images", help="folder")
    options = parser.parse_args()
    animation, sheet = options.out / "workshop.gif", options.out / "workshop.jpg"
    with tempfile.TemporaryDirectory() as folder:
        subprocess.run([sys.executable, *_DEMO, "--output", folder], check=True)
        shutil.copyfile(Path(folder) / "shadows.gif", animation)
        with Image.open(Path(folder) / "contact_sheet.png") as large:
            # As JPEG: the colours of a PNG of this size would have to be reduced to a few dozen.
            shrink(large).save(sheet, quality=_QUALITY, optimize=True, progressive=True)
    for path in (animation, sheet):
        print(path, path.stat().st_size)


if __name__ == "__main__":
    main()
