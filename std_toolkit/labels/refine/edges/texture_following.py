"""Matches with textures as residuals of the joint refinement.

Contours of a bottle leave a turn of a degree or two about its axis open; its texture does not.
Labels sit elsewhere on a bottle of another production run. A texture that leads the pose off the
contour in most views is therefore not followed, and reported.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from std_toolkit.geometry import SE3
from std_toolkit.labels.refine import problem
from std_toolkit.labels.refine.caster import LayerStore
from std_toolkit.labels.refine.edges.descent import Descent, advance, step_size_mm
from std_toolkit.labels.refine.edges.measure import Level, Measurements, PoseState, measure
from std_toolkit.labels.refine.edges.system import TextureRows, texture_rows
from std_toolkit.labels.refine.edges.texture_matches import (
    Matches,
    PhotoFeatures,
    TextureMatchSettings,
    match_texture,
)

# Rounds of matching: the reach in parts of the object's size, and the number of views.
_ROUNDS = ((0.12, 12), (0.05, 32), (0.03, 32))

# Steps of a round, and the size at which they end, mm at the surface.
_STEPS, _SETTLED_MM = 6, 0.05


def follow_textures(
    views: Sequence[problem.RefineView],
    extra: Sequence[problem.RefineView],
    objects: Sequence[problem.RefineObject],
    state: PoseState,
    descent: Descent,
    level: Level,
    options: problem.RefineOptions,
    *,
    layers: LayerStore,
    progress: problem.Progress = problem.no_progress,
) -> Descent:
    """Refine `state` with the textures of the objects beside their contours.

    Args:
        views: views whose contours were followed.
        extra: more views, used for textures only.
        objects: all objects; those with `texture` that are not fixed are matched.
        state: poses from the contours.
        descent: its result, returned where no texture is found.
        level: the finest level.
        options: options of the refinement.
        layers: cached layers of the objects in `views`.
        progress: called with the completed fraction.
    """
    textured = [i for i, o in enumerate(objects) if o.texture is not None and not o.fixed]
    if not textured:
        return descent
    every = [*views, *extra]
    scaled = [v.at_scale(level.scale) for v in views]
    photos = PhotoFeatures(every)
    trusted = list(textured)
    by_contour, start = descent, state.copy()

    def solve(matches: dict[tuple[int, int], Matches]) -> Descent:
        """Move the poses by a few steps and measure them at the end."""
        outlines = measure(
            views, scaled, objects, state, level, use_depth=options.use_depth, layers=layers
        )
        for _ in range(_STEPS):
            last_scale = state.log_scale
            rows = _rows(matches, every, state, level.scale)
            measured = outlines + Measurements([], [], rows)
            steps = advance(objects, state, measured, level.scale, options)
            outlines = outlines.after(dict(enumerate(steps)))
            moved = max(step_size_mm(o, s) for o, s in zip(objects, steps, strict=True))
            if moved < _SETTLED_MM:
                break
        rows = _rows(matches, every, state, level.scale)
        at_end = measure(
            views, scaled, objects, state, level, use_depth=options.use_depth, layers=layers
        )
        return replace(
            descent,
            measured=at_end + Measurements([], [], rows),
            step_mm=moved,
            scale_step=abs(state.log_scale - last_scale),
        )

    for number, (reach, count) in enumerate(_ROUNDS):
        matches: dict[tuple[int, int], Matches] = {}
        for done, i in enumerate(trusted):
            for k in _best_views(every, objects[i], state.poses[i], state, count):
                found = match_texture(photos, k, objects, i, state, reach)
                if found is not None:
                    matches[i, k] = found
            progress((number + (done + 1) / len(trusted)) / len(_ROUNDS))
        matches = {key: m for key, m in matches.items() if key[0] in _enough(matches)}
        if not matches:
            break
        before = state.copy()
        with_textures = solve(matches)
        wrong = {i for i in {i for i, _ in matches} if not _agree(i, matches, every, state)}
        if wrong:
            # These are matches by chance; the others are solved again without them.
            state.set(before)
            trusted = [i for i in trusted if i not in wrong]
            continue
        beside = {
            i: start.in_scale_of(state).poses[i].inverse() @ state.poses[i]
            for i in {i for i, _ in matches}
            if _leaves_contour(i, by_contour.measured, with_textures.measured)
        }
        if beside:
            # The object has another texture than the mesh: its shape tells where it is.
            state.set(start)
            trusted = [i for i in trusted if i not in beside]
            matches = {key: m for key, m in matches.items() if key[0] in trusted}
            with_textures = solve(matches) if matches else by_contour
            with_textures = replace(with_textures, beside={**descent.beside, **beside})
        descent = with_textures
    return descent


def _leaves_contour(index: int, before: Measurements, after: Measurements) -> bool:
    """Whether an object's contour left the edges of most views.

    Args:
        index: index of the object.
        before: at the pose that fits the contours best.
        after: at the pose that fits the texture as well.
    """
    limits = TextureMatchSettings.current()
    fits, left = (
        {
            rows.view: float(np.median(np.abs(rows.residual[clear])))
            for k, rows in measured.contours
            if k == index and (clear := rows.weight > 0.1).sum() >= limits.fewest_edges
        }
        for measured in (before, after)
    )
    both = sorted(fits.keys() & left.keys())
    if len(both) < limits.fewest_edge_views:
        return False
    best = np.array([fits[k] for k in both])
    rise = np.array([left[k] for k in both]) - best
    apart = [np.linalg.norm(rows.residual, axis=1) for k, rows in after.textures if k == index]
    scattered = np.median(np.concatenate(apart)) > limits.scatter * np.median(best)
    share = limits.rise_scattered if scattered else limits.rise
    return bool(np.median(rise) > max(share * np.median(best), limits.rise_px))


def _best_views(
    views: Sequence[problem.RefineView],
    obj: problem.RefineObject,
    T_world_obj: SE3,
    state: PoseState,
    count: int,
) -> list[int]:
    return problem.large_views(
        [v.camera for v in views],
        [state.camera_pose(v) for v in views],
        T_world_obj @ obj.centre,
        obj.radius,
        count=count,
        smallest_px=TextureMatchSettings.current().smallest_px,
    )


def _enough(matches: dict[tuple[int, int], Matches]) -> set[int]:
    """Objects with enough matches in enough views."""
    limits = TextureMatchSettings.current()
    found = set()
    for i in {i for i, _ in matches}:
        mine = [m for (j, _), m in matches.items() if j == i]
        many = sum(len(m.points) for m in mine) >= limits.fewest_matches
        if many and sum(len(m.points) >= 3 for m in mine) >= limits.fewest_views:
            found.add(i)
    return found


def _rows(
    matches: dict[tuple[int, int], Matches],
    views: Sequence[problem.RefineView],
    state: PoseState,
    scale: float,
) -> list[tuple[int, TextureRows]]:
    """Residuals of the matches at the current poses, in pixels of the level's images."""
    return [
        (
            i,
            texture_rows(
                m.points,
                m.pixels,
                views[k].camera,
                state.camera_pose(views[k]),
                state.poses[i],
                view=k,
                scale=scale,
            ),
        )
        for (i, k), m in matches.items()
    ]


def _agree(
    index: int,
    matches: dict[tuple[int, int], Matches],
    views: Sequence[problem.RefineView],
    state: PoseState,
) -> bool:
    """Whether the matches of an object agree with its pose better than chance would."""
    limits = TextureMatchSettings.current()
    near = total = 0
    for (i, k), m in matches.items():
        if i != index:
            continue
        T_cam_obj = state.camera_pose(views[k]).inverse() @ state.poses[i]
        error = np.linalg.norm(views[k].camera.project(T_cam_obj @ m.points) - m.pixels, axis=1)
        near += int((error < max(limits.agreed_part * m.reach, 1.5)).sum())
        total += len(error)
    return near >= limits.agreed * total
