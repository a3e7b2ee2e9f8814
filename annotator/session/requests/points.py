"""Poses from clicked points."""

from __future__ import annotations

import numpy as np

from annotator.session.edits import SetPoses
from annotator.session.requests.base import Outcome, Request, Watch
from annotator.session.snapshot import Snapshot
from std_toolkit.errors import ToolkitError
from std_toolkit.labels.pnp import solve_pnp
from std_toolkit.scene.document import Count, Positive


class SolvePnP(Request, frozen=True, kw_only=True, tag="solve_pnp"):
    """The pose of an object from the points clicked in a frame.

    Attributes:
        threshold_px: largest residual of a point that counts.
    """

    object: str
    frame: Count
    threshold_px: Positive = 4.0

    @property
    def title(self) -> str:
        return f"Pose of {self.object} from points"

    def carry_out(self, snapshot: Snapshot, watch: Watch) -> Outcome:
        del watch
        clicks = snapshot.object(self.object).clicks.get(self.frame, [])
        frame = snapshot.scene.frame(self.frame)
        if len(clicks) < 4:
            raise ToolkitError(
                f"{len(clicks)} points are clicked in frame {self.frame}",
                field="object",
                value=self.object,
                hint="a pose needs at least 4, spread over the object",
            )
        found = solve_pnp(
            np.array([c.point for c in clicks]),
            np.array([(c.u, c.v) for c in clicks]),
            snapshot.scene.camera(frame),
            threshold_px=self.threshold_px,
        )
        std = np.sqrt(np.diag(found.covariance))
        report = [
            f"{int(found.inliers.sum())} of {len(clicks)} points fit, rms {found.rmse_px:.2f} px; "
            f"standard deviation {np.linalg.norm(std[:3]) * 1000:.1f} mm, "
            f"{np.rad2deg(np.linalg.norm(std[3:])):.2f} deg"
        ]
        report += [
            f"point {i + 1}: {residual:.2f} px" + ("" if fits else " (left out)")
            for i, (residual, fits) in enumerate(
                zip(found.residuals_px, found.inliers, strict=True)
            )
        ]
        left_out = [str(i + 1) for i, fits in enumerate(found.inliers) if not fits]
        warnings = []
        if left_out:
            warnings.append(
                f"{self.object}: point {', '.join(left_out)} does not fit the others and was "
                "left out; correct or remove it"
            )
        edit = SetPoses.one(
            self.object, self.frame, found.T_cam_obj, method="pnp", label=self.title
        )
        return Outcome(edit, report, warnings)
