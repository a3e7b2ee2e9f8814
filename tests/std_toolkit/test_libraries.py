"""Libraries report nothing and take no signals."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import threading
from pathlib import Path

import matplotlib
import pytest

from std_toolkit.libraries import UNREPORTED, signals_waiting

# What docs/install.md says is kept in the home folder: about this machine, never sent.
STATED = (
    ".cache/matplotlib/",
    ".cache/fontconfig/",
    ".cache/mesa_shader_cache",
    ".cache/std-toolkit/",
    ".drjit/",
    ".rum/rum.json",
)

# Of a process whose home folder is empty: what leaves the machine is an error, and told.
NO_NETWORK = """
import sys

def refuse(event, args):
    if event in ("socket.getaddrinfo", "socket.gethostbyname"):
        host = args[0]
    elif event in ("socket.connect", "socket.sendto") and isinstance(args[1], tuple):
        host = args[1][0]
    else:
        return
    if host not in (None, "", "localhost", "127.0.0.1", "::1", "0.0.0.0"):
        sys.stderr.write(f"OUT: {event} {host}\\n")
        raise OSError("no network here")

sys.addaudithook(refuse)
"""


def alone(
    tmp_path: Path, words: list[str], *, seconds: float = 300
) -> tuple[subprocess.CompletedProcess[str], list[str]]:
    """A process without a network and with an empty home folder, and the files it left there."""
    home, site = tmp_path / "home", tmp_path / "site"
    home.mkdir(exist_ok=True)
    site.mkdir(exist_ok=True)
    (site / "sitecustomize.py").write_text(NO_NETWORK)
    repository = Path(__file__).parents[2]
    own = {k: v for k, v in os.environ.items() if not k.startswith("XDG_") and k not in UNREPORTED}
    done = subprocess.run(
        [sys.executable, *words],
        # To list the fonts of the machine again would take half a minute.
        env={
            **own,
            "HOME": str(home),
            "MPLCONFIGDIR": matplotlib.get_cachedir(),
            "PYTHONPATH": f"{site}:{repository}",
        },
        capture_output=True,
        text=True,
        timeout=seconds,
    )
    left = [p.relative_to(home).as_posix() for p in home.rglob("*") if p.is_file()]
    return done, [name for name in left if not name.startswith(STATED)]


@pytest.mark.slow
@pytest.mark.parametrize("library", ["onnxruntime", "ray", "pytorch_lightning", "pycolmap"])
def test_a_library_writes_nothing_at_home_and_asks_nobody(tmp_path: Path, library: str) -> None:
    pytest.importorskip(library)
    done, left = alone(tmp_path, ["-c", f"import std_toolkit, {library}"])
    assert done.returncode == 0, done.stderr
    assert "OUT:" not in done.stderr
    assert left == []


def test_the_refusal_is_real(tmp_path: Path) -> None:
    done, _ = alone(tmp_path, ["-c", "import socket; socket.getaddrinfo('example.org', 80)"])
    assert done.returncode != 0
    assert "OUT: socket.getaddrinfo example.org" in done.stderr


@pytest.mark.slow
@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
def test_pycolmap_takes_no_signals(number: signal.Signals) -> None:
    code = (
        "import os, signal, std_toolkit\n"
        f"signal.signal({int(number)}, lambda n, _: print('ours', n, flush=True))\n"
        "import pycolmap\n"
        f"os.kill(os.getpid(), {int(number)})\n"
        "print('here', pycolmap.Camera.__name__)\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert done.stdout == f"ours {int(number)}\nhere Camera\n"
    assert done.stderr == ""


def test_a_signal_waits_until_the_block_ends() -> None:
    told: list[str] = []
    before = signal.signal(signal.SIGTERM, lambda *_: told.append("ours"))
    try:
        with signals_waiting():
            signal.signal(signal.SIGTERM, signal.getsignal(signal.SIGTERM))
            # To this thread: another one of the process would take it at once.
            signal.pthread_kill(threading.get_ident(), signal.SIGTERM)
            told.append("end of the block")
        assert told == ["end of the block", "ours"]
    finally:
        signal.signal(signal.SIGTERM, before)
