"""The same work on a real Ray cluster: started by us, and reached through its address."""

from __future__ import annotations

import os
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

import job_items
import pytest

from std_toolkit.errors import ToolkitError
from std_toolkit.jobs import JobOptions, run_jobs

# Ray may guard clusters by a token in the home folder; these two talk on this machine only.
os.environ["RAY_AUTH_MODE"] = "disabled"
ray = pytest.importorskip("ray", reason="needs the extra [cluster]")
pytestmark = pytest.mark.slow
# Workers find installed packages, as the toolkit is; this test's own functions are sent along.
ray.cloudpickle.register_pickle_by_value(job_items)


@pytest.fixture(scope="module")
def cluster() -> Iterator[str]:
    """Address of a Ray cluster of two cores that runs outside of this process."""
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    # A head in the foreground is a process that can be ended by its id, with all it started.
    with tempfile.TemporaryDirectory(prefix="ray", dir="/tmp") as folder:
        environment = {**os.environ, "RAY_USAGE_STATS_ENABLED": "0"}
        head = subprocess.Popen(
            [
                str(Path(sys.executable).parent / "ray"),
                "start",
                "--head",
                "--block",
                f"--port={port}",
                "--node-ip-address=127.0.0.1",
                "--num-cpus=2",
                "--include-dashboard=false",
                "--object-store-memory=100000000",
                f"--temp-dir={folder}",
            ],
            env=environment,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            start_new_session=True,
        )
        assert head.stdout is not None
        for line in head.stdout:
            if "Ray runtime started" in line:
                break
        else:
            pytest.fail("the Ray cluster did not start")
        yield f"127.0.0.1:{port}"
        head.terminate()
        head.communicate(timeout=60)


def run_everywhere(folder: Path, options: JobOptions) -> dict[str, bytes]:
    folder.mkdir()
    jobs = [(i, folder) for i in range(20)]
    report = run_jobs(
        job_items.write_square, jobs, name="squares", key=lambda j: str(j[0]), options=options
    )
    report.raise_if_failed()
    assert list(report.results.values()) == [f"{i:03d}.txt" for i in range(20)]
    return {p.name: p.read_bytes() for p in sorted(folder.iterdir())}


def test_all_engines_write_identical_files(tmp_path: Path, cluster: str) -> None:
    reference = run_everywhere(tmp_path / "serial", JobOptions(engine="serial", progress=False))
    others = {
        "local": JobOptions(engine="local", workers=2, progress=False),
        "ray": JobOptions(engine="ray", ray_address=cluster, progress=False),
        "ray_started_here": JobOptions(engine="ray", workers=2, progress=False),
    }
    for name, options in others.items():
        assert run_everywhere(tmp_path / name, options) == reference, name


def test_failures_on_a_cluster_are_those_of_local_processes(tmp_path: Path, cluster: str) -> None:
    options = JobOptions(engine="ray", ray_address=cluster, progress=False)
    report = run_jobs(job_items.odd_raises, range(4), name="odd", options=options)
    assert report.results == {"0": 0, "2": 2}
    assert report.failed == {"1": "numbers: odd (got 1)", "3": "numbers: odd (got 3)"}

    jobs = [(i, tmp_path) for i in range(6)]
    killed = run_jobs(
        job_items.killed_once, jobs, name="killed", key=lambda j: str(j[0]), options=options
    )
    assert (tmp_path / "was_killed").exists()
    assert list(killed.results.values()) == list(range(6))

    aborting = run_jobs(job_items.three_aborts, range(5), name="aborts", options=options)
    assert list(aborting.results.values()) == [0, 1, 2, 4]
    assert "died 3 times" in aborting.failed["3"]
    assert not ray.is_initialized()


@pytest.mark.parametrize(
    "address", ["127.0.0.1:1", "nowhere", "host.invalid:6379", "1.2.3.4:99999"]
)
def test_an_address_without_a_cluster_is_one_clear_error(address: str) -> None:
    options = JobOptions(engine="ray", ray_address=address, progress=False)
    with pytest.raises(ToolkitError, match=r"--ray-address: .*ray start --head"):
        run_jobs(job_items.square, range(2), name="lost", options=options)


def test_a_terminated_run_says_how_to_resume_and_leaves_no_process(tmp_path: Path) -> None:
    """Ray replaces the handler of SIGTERM by one that ends the program without a word."""
    script = tmp_path / "script.py"
    script.write_text(
        "import sys\n"
        "from std_toolkit.cli.command import exit_status\n"
        "from std_toolkit.jobs import JobOptions, run_jobs\n"
        "from tests.std_toolkit.jobs.job_items import sleep_long\n"
        "import ray, tests.std_toolkit.jobs.job_items as job_items\n"
        "ray.cloudpickle.register_pickle_by_value(job_items)\n"
        "jobs = [(i, __import__('pathlib').Path(sys.argv[1])) for i in range(2)]\n"
        "options = JobOptions(engine='ray', workers=2, progress=False)\n"
        "def work():\n"
        "    run_jobs(sleep_long, jobs, name='n', key=lambda j: str(j[0]), options=options)\n"
        "    return 0\n"
        "sys.exit(exit_status(work, program='p', grace_s=3))\n"
    )
    root = Path(__file__).parents[3]
    process = subprocess.Popen(
        [sys.executable, str(script), str(tmp_path)],
        env={**os.environ, "PYTHONPATH": str(root)},
        stderr=subprocess.PIPE,
        text=True,
    )
    end = time.monotonic() + 120
    while len(started := list(tmp_path.glob("started_*"))) < 2:
        assert process.poll() is None and time.monotonic() < end
        time.sleep(0.05)
    began = time.monotonic()
    process.terminate()
    _, said = process.communicate(timeout=60)
    assert time.monotonic() - began < 5
    assert said.splitlines()[-1] == "interrupted; run the same command again to resume"
    assert process.returncode == 143
    workers = [int(path.name.split("_")[2]) for path in started]
    end = time.monotonic() + 10
    while any(Path(f"/proc/{worker}").exists() for worker in workers):
        assert time.monotonic() < end
        time.sleep(0.05)
