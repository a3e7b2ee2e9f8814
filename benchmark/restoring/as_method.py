"""What `std-restore` does by default, as a method of the benchmark.

It is no network of its own: two networks share the frame, so that a score of either alone says
little about the depth that a user gets.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from benchmark.methods.protocol import Restored, View
from benchmark.methods.registry import MethodOptions, preset_for, shipped_file
from benchmark.restoring.options import MethodChoice, Where
from benchmark.restoring.restorer import FINDER, Restorer
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
        if options.precision != "fp32":
            raise ToolkitError(
                "std-restore runs in fp32", field="--precision", value=options.precision
            )
        where = configured(ByDefaultConfig(), options.settings).where
        choice = MethodChoice(where=where)
        self._restorer = Restorer.of(choice, device=options.device)
        names = (choice.method, *((FINDER,) if where != "everywhere" else ()))
        self.weights: tuple[Path, ...] = tuple(
            shipped_file(name, preset_for(name, None, None)) for name in names
        )

    def restore(self, views: Sequence[View]) -> list[Restored]:
        """Restore views one by one, at their size; one without any measurement stays empty."""
        return [self._restore(view) for view in views]

    def _restore(self, view: View) -> Restored:
        if not (view.depth > 0).any():
            return Restored(view.depth)
        found = self._restorer.restore_view(view.color, view.depth, view.camera)
        return Restored(found.depth, found.confidence, found.spread, found.clear)
