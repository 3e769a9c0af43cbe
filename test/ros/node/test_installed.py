# SPDX-License-Identifier: Apache-2.0
"""Paths that messages name: real ones, wherever the package is installed."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

from shadow_tracer.ros.node import installed

NAME = "fastdds_large_images.xml"


def test_of_the_sources_that_run() -> None:
    assert installed.config_file(NAME) == str(Path(__file__).resolve().parents[3] / "config" / NAME)


@pytest.mark.parametrize("place", ["environment", "index"])
def test_where_it_is_installed(place: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    share = tmp_path / "share" / "shadow_tracer"
    (share / "config").mkdir(parents=True)
    (share / "package.xml").touch()
    (share / "config" / NAME).touch()
    monkeypatch.setattr(installed, "__file__", str(tmp_path / "lib" / "site-packages" / "ros" / "installed.py"))
    monkeypatch.setattr(sys, "prefix", str(tmp_path) if place == "environment" else "/nowhere")
    monkeypatch.setenv("AMENT_PREFIX_PATH", f"/opt/nothing:{tmp_path}" if place == "index" else "")
    assert installed.config_file(NAME) == str(share / "config" / NAME)
    assert installed.config_file("other.xml") == "config/other.xml of the package shadow_tracer"


def test_no_message_has_a_path_to_be_filled_in() -> None:
    sources = Path(installed.__file__).parent.glob("*.py")
    assert not [path.name for path in sources if "<share" in path.read_text(encoding="utf-8")]
