"""What `std-restore` does by default, as a method of the benchmark.

It is no network of its own: two networks share the frame, so that a score of either alone says
little about the depth that a user gets.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from benchmark.methods.protocol import Restored, View
from benchmark.methods.registry import COMPACT, JOINED, MethodOptions, shipped_file
from benchmark.restoring.options import MethodChoice, Where
from benchmark.restoring.restorer import Restorer
from std_toolkit.errors import ToolkitError
from std_toolkit.plugins import configured


@dataclass(frozen=True)
class ByDefaultConfig:
    """Settings of `ByDefault`.

    Attributes:
        where: where SwinDRNet answers, as `std-restore --where`.
    """

    where: Where = "glass-and-holes"


class ByDefault:
    """SwinDRNet on glass and metal, CompactDR elsewhere: the depth that `std-restore` writes.

    Attributes:
        weights: files of the networks that it ran.
        network, device, parameter_count: of the networks, where torch runs them.
        backend: what runs them, `onnx` or `torch`.

    Raises:
        ToolkitError: weights or a precision other than those of `std-restore`, an unknown setting,
            or a package that is not installed.
    """

    settings_type = ByDefaultConfig

    input_size = None
    needs_mask = False

    def __init__(self, options: MethodOptions) -> None:
        for field, given in (("--weights", options.weights), ("--compile", options.compile)):
            if given:
                raise ToolkitError(
                    "std-restore runs as it ships", field=field, value=str(given),
                    hint="--method swindrnet and compactdr take it",
                )  # fmt: skip
        fixed = (("--precision", options.precision, "fp32"), ("--preset", options.preset, COMPACT))
        for option, chosen, only in fixed:
            if chosen != only:
                raise ToolkitError(f"std-restore runs as {only}", field=option, value=chosen)
        where = configured(ByDefaultConfig(), options.settings).where
        choice = MethodChoice(where=where)
        self._restorer = Restorer.of(choice, device=options.device)
        first, finder = JOINED["std-restore"]
        names = (first,) if where == "everywhere" else (first, finder)
        self.weights: tuple[Path, ...] = tuple(shipped_file(name, COMPACT) for name in names)
        inner = [self._restorer.method]
        if where != "everywhere":
            inner.append(self._restorer.finder())
        self.backend = "torch" if any(hasattr(part, "network") for part in inner) else "onnx"
        if self.backend == "torch":  # which may use a GPU
            self.network = [getattr(part, "network", None) for part in inner]
            self.device = getattr(inner[0], "device", None)
            self.parameter_count = sum(getattr(part, "parameter_count", 0) for part in inner)

    def restore(self, views: Sequence[View]) -> list[Restored]:
        """Restore views one by one, at their size; one without any measurement stays empty."""
        return [self._restore(view) for view in views]

    def _restore(self, view: View) -> Restored:
        if not (view.depth > 0).any():
            return Restored(view.depth)
        found = self._restorer.restore_view(view.color, view.depth, view.camera)
        return Restored(found.depth, found.confidence, found.spread, found.clear)
