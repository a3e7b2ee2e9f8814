"""Kill commands at random moments, run them again, and compare what they make byte by byte.

    python tools/kills.py [COMMAND ...] [--kills 50] [--seed 0] [--work DIR]

Commands: import (with camera poses), export, curate (`std-curate run`), bench, restore, sim, scan,
pack, train, mine, annotate (a script of edits and saves), web and window (`std-annotate` with edits
that were not saved, which are saved at the end); all by default. A third of the kills each are
SIGKILL, SIGTERM and SIGINT. The latter two must end the command within 5 s, with a line that says
how to resume unless nothing was begun or all was done, and without a stack trace of a library. Of
meshes, the triangles are compared, as Open3D lays out a texture differently each time.
Prints a line per kill, with the processor time from the signal on, and a table; exits with 1 after
a fault.
"""

from __future__ import annotations

import argparse
import os
import random
import resource
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path

# Small inputs are written by the tests.
sys.path.insert(0, str(Path(__file__).resolve().parent.parent))
from tools.kill_cases import Case, cases, run

SIGNALS = (signal.SIGKILL, signal.SIGTERM, signal.SIGINT)
LIMIT_S = 5.0
LONGEST_S = 1800.0
CHAIN = 5  # kills of a command that does not end by itself before its work is compared


@dataclass
class Tally:
    """Counts of a case."""

    kills: int = 0
    chains: int = 0
    slowest_s: float = 0.0
    busiest_s: float = 0.0
    faults: list[str] = field(default_factory=list)

    def fault(self, told: str) -> None:
        print(f"fault: {told}", flush=True)
        self.faults.append(told)


def attack(name: str, case: Case, top: Path, kills: int, moments: random.Random) -> Tally:
    """Kill the command until `kills` kills are done; every chain of runs ends undisturbed."""
    tally, whole = Tally(), top / f"{name}-whole"
    shutil.rmtree(whole, ignore_errors=True)
    whole.mkdir()
    case.begin(whole)
    ends = case.last or case.words
    began = time.monotonic()
    run(ends(whole))
    seconds = (time.monotonic() - began) * (3 if case.last else 1)  # a server is up later
    expected = case.contents(whole)
    print(f"{name}: {len(expected)} files in {seconds:.1f} s undisturbed", flush=True)
    while tally.kills < kills:
        tally.chains += 1
        out = top / f"{name}-killed"
        shutil.rmtree(out, ignore_errors=True)
        out.mkdir()
        case.begin(out)
        reach, first = 0.6, tally.kills
        while True:
            wanted = tally.kills < kills and not (case.last and tally.kills - first == CHAIN)
            how = SIGNALS[tally.kills % len(SIGNALS)] if wanted else None
            limit = moments.uniform(0.02, reach) * seconds if wanted else LONGEST_S
            words = case.words(out) if wanted else ends(out)
            is_whole = partial(_is_one_of, case, out, (case.contents(out), expected))
            if not _killed(name, words, how, limit, tally, is_whole):
                break
            reach = min(1.2 * reach, 1.5)  # a run that is always killed early never ends
        found = case.contents(out)
        different = sorted(n for n in {*found, *expected} if found.get(n) != expected.get(n))
        if different:
            tally.fault(f"chain {tally.chains}: differs: {', '.join(different[:5])}")
        left = [p.name for p in out.rglob("*") if ".tmp" in p.name]
        if left:
            tally.fault(f"chain {tally.chains}: left behind: {', '.join(left[:5])}")
    return tally


def _is_one_of(case: Case, out: Path, states: tuple[dict[str, str], ...]) -> bool:
    return case.contents(out) in states


def _killed(
    name: str,
    words: list[str],
    how: signal.Signals | None,
    limit: float,
    tally: Tally,
    is_whole: Callable[[], bool],
) -> bool:
    """Run the command; True if it was killed before its end.

    `is_whole` tells whether the products are those before the run or those of an undisturbed one.
    """
    earlier = _processor_s()
    process = subprocess.Popen(
        words,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),
    )
    try:
        process.communicate(timeout=limit)
        if process.returncode not in (0, 1):
            tally.fault(f"ended by itself with {process.returncode}")
        return False
    except subprocess.TimeoutExpired:
        assert how is not None, "an undisturbed run hangs"
    earlier += _processor_s(process.pid)
    process.send_signal(how)
    began = time.monotonic()
    _, errors = process.communicate(timeout=LONGEST_S)
    took, busy = time.monotonic() - began, _processor_s() - earlier
    tally.kills += 1
    lines = [line for line in errors.splitlines() if line.strip()]
    told = f"{how.name} after {limit:.1f} s, ended in {took:.1f} s ({busy:.1f} s of a processor)"
    print(f"{name}: {told}, {process.returncode}: {lines[-1:]}", flush=True)
    if how == signal.SIGKILL:
        return True
    tally.slowest_s, tally.busiest_s = max(tally.slowest_s, took), max(tally.busiest_s, busy)
    if any(line.startswith(("*** SIG", "*** Aborted")) for line in lines):
        tally.fault(f"{told}: a stack trace: {lines[0]}")
    if took > LIMIT_S:
        tally.fault(f"{told}, at a load of {os.getloadavg()[0]:.0f}: too late")
    is_told = any(line.startswith("interrupted; ") for line in lines)
    # An interrupt before the first line of the entry point is reported by Python.
    is_start = lines[-1:] == ["KeyboardInterrupt"] and "programs.py" not in errors
    # The guard kills a program that has ended its work and unloads modules for seconds.
    is_silent = process.returncode in (0, -how, -signal.SIGKILL)
    if not is_told and not ((is_start or is_silent) and is_whole()):
        tally.fault(f"{told}: no line on how to resume: {lines[-1:]}")
    return True


def _processor_s(process: int | None = None) -> float:
    """Processor time of a process, or of those that have ended, with those they waited for."""
    if process is None:
        used = resource.getrusage(resource.RUSAGE_CHILDREN)
        return used.ru_utime + used.ru_stime
    parts = Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()
    return sum(map(int, parts[11:15])) / os.sysconf("SC_CLK_TCK")


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("commands", nargs="*", metavar="COMMAND")
    parser.add_argument("--kills", type=int, default=50, help="of each command (50)")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--work", type=Path, help="folder for inputs, kept for the next call")
    args = parser.parse_args()
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    if "DISPLAY" not in os.environ:
        os.environ.setdefault("QT_QPA_PLATFORM", "offscreen")
    with tempfile.TemporaryDirectory() as folder:
        top = args.work or Path(folder)
        top.mkdir(parents=True, exist_ok=True)
        tallies = {}
        for name, case in cases(top, args.commands).items():
            tallies[name] = attack(name, case, top, args.kills, random.Random(args.seed))
            print(f"{name}: {tallies[name]}", flush=True)
    print("\ncommand   kills  chains  slowest end  of a processor  faults")
    for name, tally in tallies.items():
        print(
            f"{name:8}  {tally.kills:5}  {tally.chains:6}  {tally.slowest_s:9.1f} s  "
            f"{tally.busiest_s:12.1f} s  {len(tally.faults):6}"
        )
        for fault in tally.faults:
            print(f"  {fault}")
    return int(any(tally.faults for tally in tallies.values()))


if __name__ == "__main__":
    sys.exit(main())
