# SPDX-License-Identifier: Apache-2.0
"""Jobs on a real scheduler of Dask with worker processes, over TCP on this machine alone."""

from __future__ import annotations

import os
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from bag_journey import DEPTH, FOCAL, INFO, SECOND, log_of
from bag_maker import BagMaker, image, info, transform
from bags_runs import PARAMETERS, given, marked, uncut
from elevation_files import geotiff
from valleys import hills

pytest.importorskip("distributed")

from shadow_tracer.apps import cli
from shadow_tracer.apps.fleet.cluster import run_dask

HERE = "127.0.0.1"
_HELPERS = Path(__file__).resolve().parents[2]
_ENVIRONMENT = {
    **os.environ, "PYTHONPATH": f"{_HELPERS.parent}{os.pathsep}{_HELPERS}",
    "DASK_DISTRIBUTED__ADMIN__LOW_LEVEL_LOG_LENGTH": "0",
}  # fmt: skip


@contextmanager
def started(*command: str) -> Iterator[subprocess.Popen[bytes]]:
    process = subprocess.Popen(
        [sys.executable, "-m", *command], env=_ENVIRONMENT, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
    )
    try:
        yield process
    finally:
        process.kill()
        process.wait()


def scheduler(port: int, *more: str) -> Any:
    return started("distributed.cli.dask_scheduler", "--host", HERE, "--port", str(port), "--no-dashboard", *more)


def worker(port: int) -> Any:
    return started(
        "distributed.cli.dask_worker", f"tcp://{HERE}:{port}", "--nthreads", "1", "--no-nanny", "--no-dashboard",
        "--host", HERE, "--death-timeout", "60",
    )  # fmt: skip


def free_port() -> int:
    with socket.socket() as one:
        one.bind((HERE, 0))
        return int(one.getsockname()[1])


def wait_for(folder: Path, count: int) -> None:
    end = time.monotonic() + 60
    while len([*folder.iterdir()]) < count:
        assert time.monotonic() < end, "the jobs do not go on"
        time.sleep(0.02)


@pytest.mark.slow
def test_workers_die_and_come_late_and_the_scheduler_is_started_again(tmp_path: Path) -> None:
    jobs = [(str(tmp_path), number) for number in range(40)]
    found: dict[int, Any] = {}
    wrong: list[BaseException] = []
    port = free_port()

    def known(job: tuple[str, int]) -> str | None:
        return "known" if (Path(job[0]) / str(job[1])).exists() else None

    def go() -> None:
        try:
            run_dask(
                marked, jobs, f"tcp://{HERE}:{port}", "", 1, 2, bool, known,
                lambda job, result: found.setdefault(job[1], result),
            )  # fmt: skip
        except BaseException as error:
            wrong.append(error)

    run = threading.Thread(target=go)
    with scheduler(port), worker(port) as first:
        run.start()
        wait_for(tmp_path, 3)
        with worker(port):  # it comes late
            first.kill()
            wait_for(tmp_path, 12)
    with scheduler(port), worker(port):
        run.join(120)
    assert not run.is_alive() and not wrong
    assert sorted(found) == list(range(40))
    assert set(found.values()) <= {"done", "known"}
    assert sorted(int(path.name) for path in tmp_path.iterdir()) == list(range(40))


@pytest.mark.slow
def test_no_scheduler_is_an_error(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("shadow_tracer.apps.fleet.cluster._CONNECT", 0.2)
    with pytest.raises(OSError, match="does not answer"):
        run_dask(marked, [("", 0)], f"tcp://{HERE}:{free_port()}", "", 1, 0, bool, lambda job: None, lambda *_: None)


@pytest.mark.slow
def test_a_bag_on_a_cluster_gives_the_bytes_of_one_run(tmp_path: Path) -> None:
    made = BagMaker()
    made.add("/tf_static", transform("odom", "camera", 0, (0.0, 0.0, 0.0)))
    for k in range(7):
        made.add(INFO, info(10, 8, (100 + k) * SECOND, FOCAL / 4))
        made.add(DEPTH, image(np.full((8, 10), 1500 + 10 * k, np.uint16), (100 + k) * SECOND))
    bag, out, port = made.write(tmp_path / "in"), tmp_path / "out", free_port()
    with scheduler(port), worker(port), worker(port):
        command = ["bags", str(bag), str(out), "--no-timing", *given(PARAMETERS), "--frames", "1", "--engine", "dask"]
        assert cli.main([*command, "--scheduler", f"tcp://{HERE}:{port}"]) == 0
    assert log_of(out / "in") == log_of(uncut(bag, tmp_path / "whole.mcap", PARAMETERS))


@pytest.mark.slow
def test_terrain_on_a_cluster_that_a_file_names_gives_the_bytes_of_one_process(tmp_path: Path) -> None:
    pytest.importorskip("rasterio", reason="needs the extra: pip install 'shadow_tracer[terrain]'")
    z, file, port = hills(40, 46, seed=9, height=90.0), tmp_path / "scheduler.json", free_port()
    model = geotiff(tmp_path / "dem.tif", z.astype(np.float32), nodata=-9999.0)

    def made(name: str, *more: str) -> bytes:
        out = tmp_path / name
        command = ["terrain", str(model), "--date", "2026-03-20", "--every", "3h", "--device", "cpu", "--tile", "16"]
        assert cli.main([*command, "-o", str(out), *more]) == 0
        return out.read_bytes()

    with scheduler(port, "--scheduler-file", str(file)), worker(port), worker(port):
        end = time.monotonic() + 60
        while not file.exists() and time.monotonic() < end:
            time.sleep(0.05)
        assert made("a.tif", "--engine", "dask", "--scheduler-file", str(file)) == made("b.tif")
    assert not [*tmp_path.glob("*.parts")]


@pytest.mark.slow
def test_a_cluster_of_this_machine_is_started_where_none_is_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv("DASK_SCHEDULER_ADDRESS", raising=False)
    found: dict[int, Any] = {}
    jobs = [(str(tmp_path), number) for number in range(6)]
    run_dask(marked, jobs, "", "", 2, 0, bool, lambda job: None, lambda job, result: found.setdefault(job[1], result))
    assert found == dict.fromkeys(range(6), "done") and len([*tmp_path.iterdir()]) == 6
