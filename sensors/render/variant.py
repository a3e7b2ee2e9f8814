"""Choice of the Mitsuba variant that works on this machine, tested in child processes.

A compiler that lacks an instruction aborts the process at the first image, and a graphics driver
may do worse; so every candidate renders a small scene in a child process first. The result is
cached for the process and, through an environment variable, for the workers that it starts.
"""

import os
import subprocess
import sys
from functools import lru_cache
from pathlib import Path

from std_toolkit.errors import ToolkitError
from std_toolkit.log import logger

ANSWER_VARIABLE = "STD_SIM_VARIANT"
"""Contains a variant's name; if set, the test is skipped."""
PREFERENCE = ("cuda_ad_rgb", "llvm_ad_rgb", "scalar_rgb")
SLOW_VARIANT = "scalar_rgb"
# Processor time of the test: on a busy machine the clock would condemn a variant that works. A
# process that waits forever is ended by the clock.
_CPU_SECONDS, _SECONDS = 180, 1800
_CUDA_LIBRARIES = ("libcuda.so.1", "libcuda.so")
# Exactly the code that a simulation runs, at 8 x 8 pixels: a test of other code would not prove
# that the variant works.
_TEST = (
    "from sensors.render.smoke import limit_time, render_smallest; "
    f"limit_time({_CPU_SECONDS}); "
    "render_smallest({variant!r})"
)
DONE = "rendered-finite-light"


def choose_variant(wanted: str | None = None) -> str:
    """The fastest variant that rendered the test scene on this machine.

    Args:
        wanted: use this variant; it is an error if it does not work.

    Raises:
        ToolkitError: Mitsuba is not installed, or the wanted variant (or every one) fails.
    """
    if wanted is not None:
        problem = try_variant(wanted)
        if problem is not None:
            raise ToolkitError(
                f"this variant of Mitsuba does not work here: {problem}",
                field="variant",
                value=wanted,
                hint=f"leave it out to take the best of {', '.join(PREFERENCE)}",
            )
        return wanted
    answered = os.environ.get(ANSWER_VARIABLE)
    if answered:
        return answered
    reasons: list[str] = []
    for variant in PREFERENCE:
        problem = try_variant(variant)
        if problem is None:
            os.environ[ANSWER_VARIABLE] = variant
            if variant == SLOW_VARIANT:
                logger.warning(
                    "rendering without a compiler, several times slower (%s); install libllvm19 "
                    "(tools/system-libraries simulator does)",
                    "; ".join(reasons),
                )
            return variant
        reasons.append(f"{variant}: {problem}")
    raise ToolkitError(
        f"no variant of Mitsuba works here: {'; '.join(reasons)}",
        hint="pip install 'std-toolkit[sim]', and libllvm19 from the system's packages",
    )


@lru_cache(maxsize=8)
def try_variant(variant: str) -> str | None:
    """None if the variant rendered the test scene in a child process, otherwise the reason."""
    if variant.startswith("cuda") and not _has_cuda():
        return "no CUDA driver"
    root = str(Path(__file__).resolve().parents[2])
    path = os.pathsep.join(p for p in (root, os.environ.get("PYTHONPATH", "")) if p)
    try:
        done = subprocess.run(
            [sys.executable, "-P", "-c", _TEST.format(variant=variant)],
            env={**os.environ, "PYTHONPATH": path, ANSWER_VARIABLE: variant},
            capture_output=True,
            text=True,
            timeout=_SECONDS,
        )
    except (OSError, subprocess.TimeoutExpired) as error:
        return str(error)
    if done.returncode == 0 and DONE in done.stdout:
        return None
    lines = [line.strip() for line in done.stderr.splitlines() if line.strip()]
    reported = next((x for x in lines if "ERROR" in x or "error" in x), lines[-1] if lines else "")
    return f"ended with status {done.returncode}{': ' + reported[:200] if reported else ''}"


def _has_cuda() -> bool:
    import ctypes

    for name in _CUDA_LIBRARIES:
        try:
            return bool(ctypes.CDLL(name).cuInit(0) == 0)
        except OSError:
            continue
    return False
