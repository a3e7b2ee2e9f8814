"""Icons as strokes on a 24x24 grid, shared by all front ends."""

from __future__ import annotations

# SVG paths by name, mostly action ids; "#" marks a filled one.
STROKES = {
    "open": "M3 6h6l2 2h10v11H3z",
    "save": "M4 4h13l3 3v13H4z M8 4v5h8V4 M7 20v-7h10v7",
    "add_mesh": "M11 3 4 7v8l7 4 3-1.7 M11 3l7 4v5 M4 7l7 4 7-4 M11 11v8 M18 15v6 M15 18h6",
    "undo": "M8 6 4 10l4 4 M4 10h10a5.500 5.500 0 0 1 0 11h-3",
    "redo": "M16 6l4 4-4 4 M20 10H10a5.500 5.500 0 0 0 0 11h3",
    "image": "M3 5h18v14H3z M3 16l5-5 4 4 3-3 6 5 M15.500 9a1 1 0 1 0 .01 0",
    "cloud": "M6 7h.01 M11 5h.01 M16 7h.01 M19 11h.01 M4 12h.01 M9 10h.01 M14 11h.01 M7 16h.01 "
    "M12 15h.01 M17 16h.01 M10 20h.01 M15 20h.01",
    "style_solid": "#M12 3 4 7.500v9L12 21l8-4.500v-9z",
    "style_wireframe": "M12 3 4 7.500v9L12 21l8-4.500v-9z M4 7.500l8 4.500 8-4.500 M12 12v9 "
    "M4 16.500 12 12l8 4.500 M12 3v9",
    "style_contour": "M12 3 4 7.500v9L12 21l8-4.500v-9z",
    "style_textured": "M12 3 4 7.500v9L12 21l8-4.500v-9z M4 7.500l8 4.500 8-4.500 M12 12v9 "
    "M6 12.500l4 2.250 M6 15.500l4 2.250 M14 14.750l4-2.250 M14 17.750l4-2.250 M9 6.500l5.500 3",
    "blink": "M2 12c3-5 6.500-7 10-7s7 2 10 7c-3 5-6.500 7-10 7s-7-2-10-7z M12 9a3 3 0 1 0 .01 0",
    "gizmo_move": "M12 2v20 M2 12h20 M9 5l3-3 3 3 M9 19l3 3 3-3 M5 9l-3 3 3 3 M19 9l3 3-3 3",
    "gizmo_turn": "M20 12a8 8 0 1 1-2.500-5.800 M18 2v5h-5",
    "gizmo_off": "M12 4v16 M4 12h16 M5 5l14 14",
    "axes": "M5 19V5 M5 19h14 M5 19l6-6 M3 7l2-3 2 3 M17 17l3 2-3 2",
    "clicking": "M12 2v6 M12 16v6 M2 12h6 M16 12h6 M12 11.500v1",
    "solve_points": "M4 6h.01 M4 18h.01 M11 4h.01 M9 14h.01 M13 12h8 M18 9l3 3-3 3",
    "refine": "M12 5a7 7 0 1 0 .01 0 M12 9.500a2.500 2.500 0 1 0 .01 0 M12 1v4 M12 19v4 M1 12h4 "
    "M19 12h4",
    "drop": "M3 21h18 M12 3v13 M8 12l4 4 4-4",
    "residuals": "M3 17 17 3l4 4L7 21z M7 13l2 2 M10 10l2 2 M13 7l2 2",
    "done": "M4 12l5.500 6L20 6",
    "fit_view": "M4 9V4h5 M15 4h5v5 M20 15v5h-5 M9 20H4v-5",
    "zoom_object": "M10.500 4a6.500 6.500 0 1 0 .01 0 M15.500 15.500 21 21 M10.500 8v5 M8 10.500h5",
    "previous": "M15 5l-7 7 7 7",
    "next": "M9 5l7 7-7 7",
    "swap": "M4 8h14 M14 4l4 4-4 4 M20 16H6 M10 12l-4 4 4 4",
    "add": "M12 5v14 M5 12h14",
    "close": "M6 6l12 12 M18 6 6 18",
    "info": "M12 3a9 9 0 1 0 .01 0 M12 11v6 M12 7.500v.01",
    "warning": "M12 3 2 20h20z M12 10v5 M12 17.500v.01",
    "error": "M12 3a9 9 0 1 0 .01 0 M9 9l6 6 M15 9l-6 6",
    "copy": "M8 8h12v12H8z M16 8V4H4v12h4",
    "paste": "M6 5h12v16H6z M9 3h6v4H9z M9 12h6 M9 16h6",
    "remove": "M5 7h14 M9 7V4h6v3 M7 7l1 13h8l1-13",
    "raw": "#M12 4a8 8 0 1 0 .01 0",
    "diffuse": "#M12 4a8 8 0 1 0 .01 0",
    "specular": "M12 4a8 8 0 1 0 .01 0 M8 9.500c1-2 2.500-2.800 4-2.900",
    "transparent": "M12 4a8 8 0 1 0 .01 0 M7 14c2 2.500 4.500 3.500 8 2.500",
    "note": "M5 4h14v11l-5 5H5z M14 20v-5h5 M8 9h8 M8 13h4",
    "lock": "M5 11h14v10H5z M8 11V8a4 4 0 0 1 8 0v3 M12 15v2",
    "unplace": "M4 8V4h4 M16 4h4v4 M20 16v4h-4 M8 20H4v-4 M9 9l6 6 M15 9l-6 6",
    "folder": "M3 6h6l2 2h10v11H3z",
}

# Actions that share an icon.
ALIASES = {
    "next_frame": "next",
    "previous_frame": "previous",
    "swap_1": "swap",
    "swap_2": "swap",
    "swap_3": "swap",
    "remove_object": "remove",
    "toggle_mode": "cloud",
    "mode_image": "image",
    "mode_cloud": "cloud",
    "refine_all": "refine",
    "material_raw": "raw",
    "material_diffuse": "diffuse",
    "material_specular": "specular",
    "material_transparent": "transparent",
    "gizmo": "gizmo_move",
    "shortcuts": "info",
}

_DOTS = ("cloud",)


def drawing(name: str, color: str = "currentColor") -> str:
    """Return the `<path>` of an icon, for a `viewBox` of 0 0 24 24."""
    name = ALIASES.get(name, name)
    path = STROKES[name]
    fill = color if path.startswith("#") else "none"
    return (
        f'<path d="{path.lstrip("#")}" fill="{fill}" stroke="{color}" '
        f'stroke-width="{3 if name in _DOTS else 1.7}" stroke-linecap="round" '
        'stroke-linejoin="round"/>'
    )


def svg(name: str, color: str) -> str:
    """Return the icon as a complete SVG document."""
    view_box = 'xmlns="http://www.w3.org/2000/svg" viewBox="0 0 24 24"'
    return f"<svg {view_box}>{drawing(name, color)}</svg>"


def symbols() -> str:
    """Return all icons as symbols of one SVG, named `icon-NAME`."""
    parts = [
        f'<symbol id="icon-{name}" viewBox="0 0 24 24">{drawing(name)}</symbol>'
        for name in (*STROKES, *ALIASES)
    ]
    return f"<svg style='display: none'>{''.join(parts)}</svg>"
