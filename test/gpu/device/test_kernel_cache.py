# SPDX-License-Identifier: Apache-2.0
"""A damaged module in Warp's kernel cache is removed and compiled again; nothing else in the cache is touched."""

from __future__ import annotations

import json
import logging
import os
import shutil
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
import warp as wp

from shadow_tracer import Bounds, DepthCamera, PointLight, ShadowTracer
from shadow_tracer.gpu.device import kernel_cache
from shadow_tracer.gpu.samples import rays


@wp.kernel(module=wp.get_module("shadow_tracer.test_kernel_cache"))
def double(values: wp.array(dtype=wp.int32)):
    values[wp.tid()] = 2 * values[wp.tid()]


def run() -> list[int]:
    values = wp.array([1, 2, 3], dtype=wp.int32, device="cpu")
    wp.launch(double, dim=3, inputs=[values], device="cpu")
    return values.numpy().tolist()


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """Where the compiled kernel of this file lies, in a cache of its own; the module is not loaded any more."""
    wp.init()
    monkeypatch.setattr(wp.config, "kernel_cache_dir", str(tmp_path))
    monkeypatch.setattr(kernel_cache, "_removed", set())
    double.module.unload()
    assert run() == [2, 4, 6]
    double.module.unload()
    (found,) = tmp_path.iterdir()
    yield found
    double.module.unload()


def truncate(path: Path) -> None:
    os.truncate(path, path.stat().st_size // 3)


def empty(path: Path) -> None:
    os.truncate(path, 0)


def zeros(path: Path) -> None:
    """As a file system leaves a file whose size was written and whose content was not."""
    path.write_bytes(bytes(path.stat().st_size))


DAMAGES = [(suffix, harm) for suffix in (".o", ".meta") for harm in (truncate, empty, zeros)]


@pytest.mark.parametrize(("suffix", "harm"), DAMAGES, ids=lambda value: getattr(value, "__name__", value))
@pytest.mark.slow
def test_a_damaged_module_is_compiled_again(
    folder: Path, suffix: str, harm: Callable[[Path], None], caplog: pytest.LogCaptureFixture
) -> None:
    others = [folder.parent / f"wp_{name}_1234567" for name in ("somebody", "shadow_tracer.other")]
    for other in others:
        other.mkdir()
        (other / "other.o").write_bytes(b"x")
    (others[0] / "other.meta").write_bytes(b"x")  # of somebody else, damaged as well
    (file,) = folder.glob(f"*{suffix}")
    harm(file)
    with caplog.at_level(logging.WARNING, "shadow_tracer"):
        assert kernel_cache.mending(run) == [2, 4, 6]
    (record,) = caplog.records
    assert f"{folder} was damaged and has been removed" in record.getMessage()
    double.module.unload()
    assert run() == [2, 4, 6], "what is in the cache now is whole"
    assert sorted(folder.parent.iterdir()) == sorted([*others, folder])
    assert all((other / "other.o").read_bytes() == b"x" for other in others)


@pytest.mark.slow
def test_what_cannot_be_mended_names_the_folder_and_the_cure(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (file,) = folder.glob("*.o")
    truncate(file)
    kernel_cache._removed.add(folder)  # it was compiled again before, and is damaged again
    with pytest.raises(RuntimeError, match=f"^kernel cache: {folder} .*; delete {folder} and start again.*WARP_CACHE"):
        kernel_cache.mending(run)

    def refuse(*_: Any) -> None:
        raise PermissionError(13, "Permission denied")

    kernel_cache._removed.clear()
    monkeypatch.setattr(os, "rename", refuse)
    with pytest.raises(RuntimeError, match=f"^kernel cache: .*Permission denied.*; delete {folder} and"):
        kernel_cache.mending(run)
    assert file.exists()


@pytest.mark.slow
def test_another_error_is_left_as_it_is(folder: Path) -> None:
    """Also one that says the same of a module of somebody else, or comes from other JSON."""
    for text in ("bad", "Failed to load CPU module 'mine' (device='cpu', block_dim=1, module_hash=1234567)"):

        def fail(text: str = text) -> None:
            raise ValueError(text)

        with pytest.raises(ValueError) as caught:
            kernel_cache.mending(fail)
        assert str(caught.value) == text
    (file,) = folder.glob("*.meta")
    truncate(file)
    with pytest.raises(json.JSONDecodeError):
        kernel_cache.mending(lambda: json.loads(""))
    assert file.exists()


@pytest.mark.slow
def test_an_error_of_the_compiler_removes_nothing(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def broken(*_: Any, **__: Any) -> None:
        raise OSError("No space left on device")

    shutil.rmtree(folder)
    monkeypatch.setattr("warp._src.build.build_cpu", broken)
    with pytest.raises(OSError, match="No space left"):
        kernel_cache.mending(run)


@pytest.mark.parametrize("owner", ["tracer", "camera"])
def test_tracers_and_depth_cameras_mend(owner: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Both do their frames through it, and do a frame again as a whole."""
    seen = []
    real = kernel_cache.mending

    def twice(work: Callable[[], Any]) -> Any:
        seen.append(work)
        real(work)
        return real(work)

    monkeypatch.setattr("shadow_tracer.gpu.device.seats.mending", twice)
    if owner == "camera":
        DepthCamera("cpu", Bounds(max_triangles=10, max_rays=100))
    else:
        tracer = ShadowTracer("brute_force", device="cpu", bounds=Bounds(max_triangles=10, max_rays=100))
        tracer.scene.put("t", [(-1, -1, 2), (1, -1, 2), (0, 1, 2)], [(0, 1, 2)])
        assert tracer.occluded([(0, 0, 3.0), (5, 0, 3)], PointLight("l", (0, 0, 0))).tolist() == [True, False]
    assert seen


@pytest.mark.slow
def test_a_program_starts_with_a_damaged_cache(tmp_path: Path) -> None:
    """From end to end: all files of the module that makes rays are cut short."""
    ShadowTracer("brute_force", device="cpu", bounds=Bounds(max_triangles=10, max_rays=10)).warm_up()
    shutil.copytree(wp.config.kernel_cache_dir, tmp_path / wp.__version__)
    files = list(tmp_path.glob(f"*/wp_{rays.__name__}_*/*.o"))
    assert files
    for file in files:
        truncate(file)
    code = (
        "from shadow_tracer import *; t = ShadowTracer('brute_force', device='cpu', "
        "bounds=Bounds(max_triangles=10, max_rays=10)); t.scene.put('t', [(-1, -1, 2), (1, -1, 2), (0, 1, 2)], "
        "[(0, 1, 2)]); print(t.occluded([[0, 0, 3.0]], PointLight('l', (0, 0, 0))))"
    )
    environment = {**os.environ, "WARP_CACHE_PATH": str(tmp_path)}
    done = subprocess.run([sys.executable, "-c", code], env=environment, capture_output=True, text=True)
    assert done.returncode == 0 and done.stdout.strip() == "[ True]", done.stderr
    assert "was damaged and has been removed" in done.stderr
