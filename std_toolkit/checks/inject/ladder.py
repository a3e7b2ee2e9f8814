"""Search for the smallest fault that is caught, on a ladder of sizes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

from std_toolkit.checks.detectability import FaultRow, FaultTrial
from std_toolkit.checks.gates.gate import REFUSED
from std_toolkit.checks.inject.faults import Fault, FaultKind
from std_toolkit.checks.result import CheckReport


@dataclass(frozen=True)
class TrialOutcome:
    """What the judge says with one fault in one direction.

    Attributes:
        caught_by: keys of the gates that caught it; empty if it was missed.
        ratios: values of the gates divided by their limits, by key; of a fault of one object those
            of this object.
    """

    caught_by: tuple[str, ...]
    ratios: dict[str, float]

    @staticmethod
    def of(plain: CheckReport, report: CheckReport, fault: Fault) -> TrialOutcome:
        """The outcome of a fault.

        A fault of an object is caught if its verdict turns doubtful or wrong; one of the scene if
        a gate of the scene fails that passes without it, or if a label is refused that was not.

        Args:
            plain: the report without the fault.
            report: with it.
            fault: the fault.
        """
        refused = {o.object for o in plain.objects if o.verdict in REFUSED}
        new = [o for o in report.objects if o.verdict in REFUSED and o.object not in refused]
        if fault.object:
            item = next((o for o in report.objects if o.object == fault.object), None)
            values = {} if item is None else {f.gate: f.value for f in item.gates}
            found = [o for o in new if o.object == fault.object]
            caught = [f.gate for o in found for f in o.gates if f.verdict in REFUSED]
        else:
            values = {g.key: g.value for g in report.gates}
            failed = {g.key for g in plain.failed_gates()}
            caught = [g.key for g in report.failed_gates() if g.key not in failed]
            caught += ["verdict"] if new and not caught else []
        ratios = {}
        for gate in report.gates:
            value = values.get(gate.key)
            if value is not None and gate.limit > 0:
                low = gate.rule == "at most"
                ratios[gate.key] = value / gate.limit if low else gate.limit / max(value, 1e-9)
        return TrialOutcome(tuple(caught), ratios)


@dataclass
class Search:
    """Bisection of one kind of fault on its ladder, then a look at the sizes above.

    A large fault may be missed where a small one is caught, as nothing is seen there.

    Attributes:
        kind: the ladder.
        fault: the fault with size 0.
        name: of the object, or "(scene)".
        frames: ids of the frames that it changes.
        note: why nothing is tried, or "".
        low, high: indices of the largest size known as missed and the smallest known as caught.
        outcomes: by size, of both directions.
    """

    kind: FaultKind
    fault: Fault
    name: str
    frames: list[int]
    note: str = ""
    low: int = -1
    high: int = 0
    outcomes: dict[float, list[TrialOutcome]] = field(default_factory=dict)
    _looked_above: bool = False

    def __post_init__(self) -> None:
        self.high = len(self.kind.sizes)

    @property
    def promise(self) -> float | None:
        """Smallest size that is caught; None if none is, or not known yet."""
        known = not self.note and self.high - self.low <= 1 and self.high < len(self.kind.sizes)
        return self.kind.sizes[self.high] if known else None

    def next_sizes(self) -> list[float]:
        """Sizes to try next; none when all is known."""
        if self.note:
            return []
        if self.high - self.low > 1:
            return [self.kind.sizes[(self.low + self.high) // 2]]
        if self._looked_above:
            return []
        # Every second one from the largest downwards.
        return [s for s in self.kind.sizes[: self.high : -1][::2] if s not in self.outcomes]

    def faults(self, size: float) -> list[Fault]:
        """The fault of a size in each direction."""
        return [replace(self.fault, size=sign * size) for sign in self.kind.signs]

    def record(self, size: float, outcomes: list[TrialOutcome]) -> None:
        """Enter what a size gave."""
        self.outcomes[size] = outcomes
        if self.high - self.low > 1:
            caught, at = self.is_caught(size), self.kind.sizes.index(size)
            self.low, self.high = (self.low, at) if caught else (at, self.high)
        else:
            self._looked_above = True

    def confirm(self, outcomes: list[TrialOutcome]) -> bool:
        """Enter what the promised size gives with more frames; False if it is missed there."""
        size = self.promise
        assert size is not None
        self.outcomes[size] = outcomes
        if self.is_caught(size):
            return True
        self.low, self.high = self.high, self.high + 1
        return False

    def is_caught(self, size: float) -> bool:
        """Whether a size was caught in all directions."""
        found = self.outcomes.get(size)
        return found is not None and all(o.caught_by for o in found)

    def row(self, plain: CheckReport) -> FaultRow:
        """The row of the report.

        Args:
            plain: the report without faults.
        """
        without = TrialOutcome.of(plain, plain, self.fault)
        outcomes = {0.0: [without], **dict(sorted(self.outcomes.items()))}
        changed = [
            key
            for key, ratio in without.ratios.items()
            if any(o.ratios.get(key, ratio) != ratio for found in outcomes.values() for o in found)
        ]
        trials = [
            FaultTrial(
                size=size,
                caught=bool(size) and all(o.caught_by for o in found),
                gates=list(dict.fromkeys(k for o in found for k in o.caught_by)),
                ratio=_ratio(found, changed),
            )
            for size, found in outcomes.items()
        ]
        promise = self.promise
        missed = [t.size for t in trials if not t.caught]
        beyond = [size for size in missed if promise is not None and size > promise]
        return FaultRow(
            object=self.fault.object or None,
            name=self.name,
            fault=self.kind.name,
            unit=self.kind.unit,
            caught_from=promise,
            caught_to=max(t.size for t in trials if t.size < beyond[0]) if beyond else None,
            missed_to=max(size for size in missed if promise is None or size < promise),
            gates=next((t.gates for t in trials if t.size == promise), []),
            note=self.note,
            trials=[] if self.note else trials,
        )


def _ratio(outcomes: Sequence[TrialOutcome], keys: Sequence[str]) -> float | None:
    """Largest value over limit among some gates, in the direction in which it is smaller."""
    found = [[o.ratios[k] for k in keys if k in o.ratios] for o in outcomes]
    return round(min(max(r) for r in found if r), 4) if any(found) else None
