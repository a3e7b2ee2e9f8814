"""Which worker process gets which GPU."""

from __future__ import annotations

import fcntl
import os
import time
from functools import cache
from pathlib import Path

from std_toolkit.errors import ToolkitError

# A worker that takes the place of a dead one waits until the system has freed its lock.
_PATIENCE_S = 30.0


def check_device(name: str) -> None:
    """See that a device exists, whether or not the method will use it.

    Raises:
        ToolkitError: no device is called so, or this machine does not have it.
    """
    if name != "cpu":  # torch is not needed to know that it is there
        from benchmark.methods.network import device_called

        device_called(name)


@cache
def claim_device(devices: tuple[str, ...], folder: Path) -> str:
    """The device of this process until it ends; no two processes of a run get the same.

    A lock on a file per device decides, which a dead process frees by dying. One device alone is
    not locked: the run then has as many workers on it as the user asked for.

    Args:
        devices: torch devices.
        folder: where the lock files lie, one folder per run.

    Raises:
        ToolkitError: all are taken.
    """
    if len(devices) == 1:
        return devices[0]
    folder.mkdir(parents=True, exist_ok=True)
    end = time.monotonic() + _PATIENCE_S
    while time.monotonic() < end:
        for device in devices:
            if _hold(folder / f"device-{device.replace(':', '-')}.lock"):
                return device
        time.sleep(0.1)
    raise ToolkitError(
        "more worker processes than devices",
        field="--device",
        value=" ".join(devices),
        hint="--workers is the number of devices, or less",
    )


def _hold(path: Path) -> bool:
    descriptor = os.open(path, os.O_RDWR | os.O_CREAT, 0o666)
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        os.close(descriptor)
        return False
    return True  # left open on purpose: the lock lives as long as the process
