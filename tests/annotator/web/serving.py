"""A scene served by the real command, in a process of its own."""

from __future__ import annotations

import os
import re
import signal
import subprocess
import sys
import time
from dataclasses import dataclass
from pathlib import Path

START_S = 120.0


@dataclass
class Served:
    """A running `std-annotate --web`.

    Attributes:
        scene: the scene folder.
        url: that the command printed.
        log: what it prints.
    """

    scene: Path
    url: str
    log: Path
    process: subprocess.Popen[str]

    @property
    def port(self) -> int:
        return int(re.search(r":(\d+)", self.url.removeprefix("http://"))[1])  # type: ignore[index]

    def stop(self, how: int = signal.SIGINT) -> int:
        """End it with a signal; returns its exit status."""
        self.process.send_signal(how)
        return self.process.wait(timeout=60)


def start(scene: Path, log: Path, *options: str) -> Served:
    """Start the command and wait for the address that it prints."""
    environment = {k: v for k, v in os.environ.items() if k != "DISPLAY"}
    # The folder of meshes of whoever runs the tests is not shown, and not replaced.
    environment["XDG_CONFIG_HOME"] = str(log.parent / "config")
    environment["XDG_CACHE_HOME"] = str(log.parent / "cache")
    command = [sys.executable, "-m", "annotator.cli", str(scene), "--web", "0", *options]
    with log.open("w") as stderr:
        process = subprocess.Popen(
            command, stderr=stderr, stdout=subprocess.DEVNULL, text=True, env=environment,
            # Ctrl-C of the person at the terminal is for the tests; ours is sent on purpose.
            preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),
        )  # fmt: skip
    deadline = time.monotonic() + START_S
    while time.monotonic() < deadline:
        found = re.search(r"open (http://\S+) in", log.read_text())
        if found:
            return Served(scene, found[1], log, process)
        assert process.poll() is None, log.read_text()
        time.sleep(0.05)
    process.kill()
    raise AssertionError(f"no address within {START_S} s: {log.read_text()}")
