"""Depth of the infrared pair by a stereo matcher, aligned to the colour image.

The matchers are those of the simulator: the local one leaves holes as depth cameras do, SGBM is
OpenCV's, `dreds` that of the released simulator. Colour and the sensor's depth are not used.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from math import ceil, floor
from typing import Any, ClassVar

from benchmark.data.infrared import InfraredPair
from benchmark.methods.depth.filling.filler import check_range
from benchmark.methods.protocol import Restored, View
from benchmark.methods.registry import MethodOptions
from std_toolkit.errors import ToolkitError
from std_toolkit.plugins import configured

_MOST_DISPARITIES = 500


@dataclass(frozen=True, kw_only=True)
class StereoSettings:
    """Settings.

    Attributes:
        near_m, far_m: range of depth that is searched, in the left infrared camera.
        matcher: name or place of another matcher of `std_toolkit.stereo_matchers`, with its own
            search range.

    Raises:
        ToolkitError: a value outside its range.
    """

    near_m: float = 0.2
    far_m: float = 5.0
    matcher: str = ""

    def __post_init__(self) -> None:
        check_range("near_m", self.near_m, 0.01, 100)
        check_range("far_m", self.far_m, 2 * self.near_m, 1000)


class StereoMethod:
    """A stereo matcher on the infrared pair.

    Args:
        options: settings are those of `StereoSettings`.

    Raises:
        ToolkitError: an unknown setting or matcher, or weights.
    """

    settings_type = StereoSettings
    input_size: tuple[int, int] | None = None
    needs_mask = False
    needs_infrared = True
    matcher: ClassVar[str] = "local"

    def __init__(self, options: MethodOptions | None = None) -> None:
        given = options or MethodOptions()
        if given.weights is not None:
            raise ToolkitError(
                "the method has no weights", field="--weights", value=str(given.weights)
            )
        self.settings = configured(StereoSettings(), given.settings)
        from sensors.stereo import MATCHERS

        MATCHERS.get(self.settings.matcher or self.matcher)  # an unknown one fails here

    def restore(self, views: Sequence[View]) -> list[Restored]:
        """Match the pair of each view.

        Raises:
            ToolkitError: a view without an infrared pair, or a matcher's package is missing.
        """
        return [self._restored(view) for view in views]

    def _restored(self, view: View) -> Restored:
        from sensors.align import align_depth
        from sensors.stereo import disparity_to_depth, make_matcher

        pair = view.infrared
        if pair is None:
            raise ToolkitError("the view has no infrared pair", field="infrared")
        name = self.settings.matcher or self.matcher
        matcher = make_matcher(name, **self._search(name, pair))
        depth = disparity_to_depth(
            matcher.match(pair.left, pair.right),
            focal_px=pair.camera.fx,
            baseline_m=pair.baseline_m,
            range_m=(self.settings.near_m, self.settings.far_m),
        )
        return Restored(align_depth(depth, pair.camera, view.camera, pair.T_color_left))

    def _search(self, name: str, pair: InfraredPair) -> dict[str, Any]:
        """Options of the built-in matchers for the range of depth."""
        reach = pair.camera.fx * pair.baseline_m
        # The ends of a matcher's range never win: one more on each side.
        low = max(0, floor(reach / self.settings.far_m) - 1)
        # No more than a quarter of the image (farther left there is little to compare), and no
        # more than the local matcher holds.
        most = min(pair.camera.width // 4, _MOST_DISPARITIES)
        high = min(ceil(reach / self.settings.near_m) + 1, low + most)
        if name == "sgbm":  # searches a multiple of 16
            return {"min_disparity": low, "disparities": -(-(high - low + 1) // 16) * 16}
        if name in ("local", "dreds"):
            return {"min_disparity": low, "max_disparity": max(high, low + 4)}
        return {}


class StereoLocal(StereoMethod):
    """The toolkit's local stereo matcher on the infrared pair."""


class StereoSgbm(StereoMethod):
    """OpenCV's semi-global stereo matcher (SGBM) on the infrared pair."""

    matcher = "sgbm"


class StereoDreds(StereoMethod):
    """The stereo matcher of DREDS' released simulator on the infrared pair."""

    matcher = "dreds"
