"""Text in a view: what it shows, names of objects, and what to do where there is nothing."""

from __future__ import annotations

from vtkmodules.vtkRenderingCore import vtkActor2D, vtkTextActor, vtkTextProperty

from annotator.views.layers import Layers

PAPER = (0.06, 0.07, 0.085)
INK = (0.93, 0.94, 0.95)
FAINT = (0.70, 0.73, 0.77)


class Captions:
    """Text of one view; positions are from the top-left corner in physical pixels."""

    def __init__(self, layers: Layers) -> None:
        self._layers = layers
        self._actors: dict[str, vtkTextActor] = {}
        self._used: set[str] = set()

    def begin(self) -> None:
        """What is not said again until `end` disappears."""
        self._used = set()

    def end(self) -> None:
        for key, actor in self._actors.items():
            actor.SetVisibility(key in self._used)

    def texts(self) -> list[str]:
        """What is said now."""
        return [self._actors[key].GetInput() for key in sorted(self._used)]

    def say(
        self,
        key: str,
        text: str,
        at: tuple[float, float],
        *,
        size: float,
        color: tuple[float, float, float] = INK,
        paper: tuple[float, float, float] = PAPER,
        opacity: float = 0.62,
        align: str = "left",
        valign: str = "top",
        bold: bool = False,
    ) -> None:
        """Put a text on a box.

        Args:
            key: the same key changes the same text.
            size: of the letters in physical pixels.
            align, valign: which side or the "center" of the text lies at `at`.
        """
        actor = self._actors.get(key)
        if actor is None:
            actor = vtkTextActor()
            actor.SetTextScaleModeToNone()
            self._layers.glass.AddViewProp(actor)
            self._actors[key] = actor
        self._used.add(key)
        if actor.GetInput() != text:
            actor.SetInput(text)
        style = actor.GetTextProperty()
        _set_style(style, size, color, paper, opacity, align, valign, bold)
        _place(actor, at, self._layers.size[1])

    def close(self) -> None:
        for actor in self._actors.values():
            self._layers.glass.RemoveViewProp(actor)
        self._actors.clear()


def _set_style(
    style: vtkTextProperty,
    size: float,
    color: tuple[float, float, float],
    paper: tuple[float, float, float],
    opacity: float,
    align: str,
    valign: str,
    bold: bool,
) -> None:
    style.SetFontFamilyToArial()
    # VTK counts in points at 72 dots per inch.
    style.SetFontSize(round(size))
    style.SetColor(*color)
    style.SetBackgroundColor(*paper)
    style.SetBackgroundOpacity(opacity)
    style.SetBold(bold)
    style.SetLineSpacing(1.25)
    style.SetJustification({"left": 0, "center": 1, "right": 2}[align])
    style.SetVerticalJustification({"bottom": 0, "center": 1, "top": 2}[valign])


def _place(actor: vtkActor2D, at: tuple[float, float], height: int) -> None:
    # Whole pixels: letters between two would be blurred.
    actor.SetPosition(round(at[0]), round(height - at[1]))
