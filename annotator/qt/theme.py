"""Theme, text size and icons of the window, from the palettes that it shares with the page."""

from __future__ import annotations

import dataclasses
from functools import cache

from PySide6.QtCore import QByteArray, QObject, QRectF, QSize, Qt, Signal
from PySide6.QtGui import QAction, QColor, QIcon, QPainter, QPalette, QPixmap
from PySide6.QtSvg import QSvgRenderer
from PySide6.QtWidgets import (
    QAbstractButton,
    QApplication,
    QComboBox,
    QLabel,
    QListWidget,
    QStyleFactory,
    QWidget,
)

from annotator.app import icons
from annotator.app.palette import DARK, LIGHT, USUAL_TEXT, Palette


class Look(QObject):
    """What the window looks like; panels refresh themselves when it changes.

    Attributes:
        palette: the colours.
        text: text size, percent of the usual one.
        points: text size, points.

    Signals:
        changed: the palette or the text size is another.
    """

    changed = Signal()

    def __init__(self) -> None:
        super().__init__()
        self.palette: Palette = DARK
        self.text = USUAL_TEXT
        self.points = 0.0
        self._usual_points = 0.0

    @property
    def light(self) -> bool:
        return self.palette is LIGHT

    def apply(self, app: QApplication, *, light: bool, text: int) -> None:
        """Change all windows of the program.

        Args:
            text: text size, percent of the desktop's.
        """
        old, self.palette = self.palette, LIGHT if light else DARK
        self._usual_points = self._usual_points or app.font().pointSizeF()
        self.text, self.points = text, self._usual_points * text / 100
        font = app.font()
        font.setPointSizeF(self.points)
        app.setFont(font)
        app.setPalette(_qt_palette(self.palette))
        app.setStyleSheet(_style(self.palette, self.points))
        if old is not self.palette:
            _redraw_icons(app, old, self.palette)
        self.changed.emit()


look = Look()


def __getattr__(name: str) -> str:
    """Return a colour of the palette in use by its name in capitals, such as `theme.MUTED`."""
    color = getattr(look.palette, name.lower(), None)
    if not name.isupper() or not isinstance(color, str):
        raise AttributeError(name)
    return color


def apply_theme(app: QApplication, *, light: bool = False, text: int = USUAL_TEXT) -> None:
    """Apply the theme, based on Qt's Fusion style, which looks the same on every desktop."""
    app.setStyle(QStyleFactory.create("Fusion"))
    look.apply(app, light=light, text=text)


def set_ink(widget: QWidget, ink: str) -> None:
    """Write the words of a widget in a colour of the palette, such as "warning"; "": the usual."""
    mark(widget, "ink", ink)


def mark(widget: QWidget, name: str, value: str) -> None:
    """Set a property on which rules of the style sheet depend."""
    if widget.property(name) != value:
        widget.setProperty(name, value)
        widget.style().unpolish(widget)
        widget.style().polish(widget)


def _style(p: Palette, points: float) -> str:
    return f"""
QToolTip {{ color: {p.text}; background: {p.raised}; border: 1px solid {p.border};
  padding: 4px 6px; }}
QMenuBar {{ background: {p.window}; padding: 1px 4px; }}
QMenuBar::item {{ padding: 3px 8px; border-radius: 3px; }}
QMenuBar::item:selected {{ background: {p.hover}; }}
QMenu {{ background: {p.raised}; border: 1px solid {p.border}; padding: 4px; }}
QMenu::item {{ padding: 4px 22px 4px 24px; border-radius: 3px; }}
QMenu::item:selected {{ background: {p.chosen}; color: {p.on_chosen}; }}
QMenu::item:disabled {{ color: {p.faint}; }}
QMenu::separator {{ height: 1px; background: {p.border}; margin: 4px 6px; }}
QMenu::indicator {{ width: 14px; height: 14px; margin-left: 5px; }}
QToolBar {{ background: {p.window}; border: 0; border-bottom: 1px solid {p.border};
  spacing: 1px; padding: 2px 4px; }}
QWidget#line {{ background: {p.border}; }}
QToolButton {{ border: 1px solid transparent; border-radius: 4px; padding: 3px; }}
QToolButton:hover {{ background: {p.hover}; }}
QToolButton:checked {{ background: {p.chosen}; color: {p.on_chosen}; border-color: {p.accent}; }}
QToolButton:disabled {{ color: {p.faint}; }}
QToolButton#labelled {{ padding: 3px 7px 3px 5px; }}
QPushButton {{ background: {p.raised}; border: 1px solid {p.border}; border-radius: 4px;
  padding: 4px 10px; }}
QPushButton:hover {{ background: {p.hover}; }}
QPushButton:pressed {{ background: {p.base}; }}
QPushButton:disabled {{ color: {p.faint}; background: {p.window}; }}
QPushButton:default, QPushButton#primary {{ background: {p.chosen}; color: {p.on_chosen};
  border-color: {p.accent}; }}
QPushButton:default:disabled, QPushButton#primary:disabled {{ background: {p.window};
  color: {p.faint}; border-color: {p.border}; }}
QPushButton:focus {{ border-color: {p.accent}; }}
QLineEdit, QPlainTextEdit {{ background: {p.base};
  border: 1px solid {p.border}; border-radius: 3px; padding: 2px 4px;
  selection-background-color: {p.chosen}; selection-color: {p.on_chosen}; }}
QAbstractSpinBox QLineEdit {{ border: 0; padding: 0; background: transparent; }}
QLineEdit:focus, QPlainTextEdit:focus {{ border-color: {p.accent}; }}
QLineEdit:disabled {{ color: {p.faint}; background: {p.window}; }}
QComboBox QAbstractItemView {{ background: {p.raised}; border: 1px solid {p.border};
  selection-background-color: {p.chosen}; selection-color: {p.on_chosen}; }}
QAbstractItemView {{ background: {p.base}; border: 1px solid {p.border}; border-radius: 3px;
  outline: 0; }}
QHeaderView::section {{ background: {p.window}; color: {p.muted}; border: 0;
  border-bottom: 1px solid {p.border}; padding: 2px 4px; }}
QTableView {{ gridline-color: {p.window}; selection-background-color: {p.chosen};
  selection-color: {p.on_chosen}; }}
QRadioButton::indicator, QCheckBox::indicator {{ width: 12px; height: 12px;
  border: 1px solid {p.faint}; background: {p.base}; }}
QRadioButton::indicator {{ border-radius: 7px; }}
QCheckBox::indicator {{ border-radius: 3px; }}
QRadioButton::indicator:hover, QCheckBox::indicator:hover {{ border-color: {p.accent}; }}
QRadioButton::indicator:checked, QCheckBox::indicator:checked {{ border-color: {p.accent};
  background: qradialgradient(cx:0.5, cy:0.5, radius:0.5, fx:0.5, fy:0.5, stop:0 {p.on_chosen},
  stop:0.55 {p.on_chosen}, stop:0.65 {p.chosen}, stop:1 {p.chosen}); }}
QRadioButton::indicator:disabled, QCheckBox::indicator:disabled {{ border-color: {p.border};
  background: {p.window}; }}
QRadioButton::indicator:checked:disabled, QCheckBox::indicator:checked:disabled {{
  background: {p.faint}; }}
QTabWidget::pane {{ border: 0; border-top: 1px solid {p.border}; }}
QTabBar::tab {{ padding: 4px 10px; color: {p.muted}; border-bottom: 2px solid transparent; }}
QTabBar::tab:selected {{ color: {p.text}; border-bottom-color: {p.accent}; }}
QTabBar::tab:hover {{ color: {p.text}; }}
QSplitter::handle {{ background: {p.window}; }}
QSplitter::handle:hover {{ background: {p.hover}; }}
QScrollBar {{ background: transparent; border: 0; }}
QScrollBar:vertical {{ width: 10px; }}
QScrollBar:horizontal {{ height: 10px; }}
QScrollBar::handle {{ background: {p.hover}; border-radius: 4px; margin: 1px; min-height: 24px;
  min-width: 24px; }}
QScrollBar::handle:hover {{ background: {p.faint}; }}
QScrollBar::add-line, QScrollBar::sub-line, QScrollBar::add-page, QScrollBar::sub-page {{
  background: transparent; border: 0; width: 0; height: 0; }}
QSlider::groove:horizontal {{ height: 4px; background: {p.base}; border-radius: 2px; }}
QSlider::sub-page:horizontal {{ background: {p.chosen}; border-radius: 2px; }}
QSlider::handle:horizontal {{ width: 12px; height: 12px; margin: -4px 0; border-radius: 6px;
  background: {p.text}; }}
QProgressBar {{ background: {p.base}; border: 1px solid {p.border}; border-radius: 3px;
  text-align: center; max-height: 14px; }}
QProgressBar::chunk {{ background: {p.chosen}; }}
QStatusBar {{ background: {p.window}; border-top: 1px solid {p.border}; }}
QStatusBar::item {{ border: 0; }}
QLabel#muted {{ color: {p.muted}; }}
QLabel#heading {{ font-weight: 600; }}
QLabel#word {{ font-size: {1.7 * points:.1f}pt; font-weight: 600; }}
QPushButton#small {{ padding: 0px 6px; }}
QLabel#empty {{ color: {p.muted}; padding: 10px; }}
QLabel#title {{ font-size: {2 * points:.1f}pt; font-weight: 300; }}
QListWidget#roomy::item {{ padding: 5px 4px; border-radius: 3px; }}
QListWidget#roomy::item:hover {{ background: {p.hover}; }}
QFrame#card {{ background: {p.raised}; border: 1px solid {p.border}; border-radius: 6px; }}
QFrame#card QScrollArea, QWidget#rows {{ background: transparent; }}
QFrame#tile {{ border: 1px solid {p.window}; }}
QFrame#tile[inhand="true"] {{ border-color: {p.accent}; }}
QWidget#corner {{ background: {p.window}; border-radius: 4px; }}
QWidget#corner QToolButton {{ padding: 2px; }}
QFrame#message {{ background: {p.raised}; border: 1px solid {p.border}; }}
{_inks(p)}
"""


def _inks(p: Palette) -> str:
    words = ("text", "muted", "accent", "good", "warning", "bad")
    grades = {g: p.grade(g) for g in ("fits", "doubtful", "wrong", "unknown")}
    inks = {w: getattr(p, w) for w in words} | grades
    rules = [f'QLabel[ink="{name}"] {{ color: {color}; }}' for name, color in inks.items()]
    rules += [
        f'QFrame#message[level="{level}"] {{ border-left: 3px solid {p.level(level)}; }}'
        for level in ("info", "warning", "error")
    ]
    return "\n".join(rules)


def _qt_palette(p: Palette) -> QPalette:
    palette = QPalette()
    role = QPalette.ColorRole
    for target, color in {
        role.Window: p.window,
        role.WindowText: p.text,
        role.Base: p.base,
        role.AlternateBase: p.window,
        role.ToolTipBase: p.raised,
        role.ToolTipText: p.text,
        role.Text: p.text,
        role.Button: p.raised,
        role.ButtonText: p.text,
        role.BrightText: p.bad,
        role.Link: p.accent,
        role.Highlight: p.chosen,
        role.HighlightedText: p.on_chosen,
        role.PlaceholderText: p.muted,
    }.items():
        palette.setColor(target, QColor(color))
    for target in (role.WindowText, role.Text, role.ButtonText):
        palette.setColor(QPalette.ColorGroup.Disabled, target, QColor(p.faint))
    return palette


# --- icons ----------------------------------------------------------------------------------------

# What icons and pictures show, by the key that Qt gives to them and to their copies.
_drawn: dict[int, tuple[str, str]] = {}


def icon(name: str, color: str = "") -> QIcon:
    """Return the icon of a name; an empty one if there is none.

    Args:
        color: of the palette in use; default: that of words.
    """
    if icons.ALIASES.get(name, name) not in icons.STROKES:
        return QIcon()
    color = color or look.palette.text
    made = _icon(name, color, look.palette.faint)
    _drawn[made.cacheKey()] = (name, color)
    return made


@cache
def _icon(name: str, color: str, disabled: str) -> QIcon:
    result = QIcon()
    for mode, ink in ((QIcon.Mode.Normal, color), (QIcon.Mode.Disabled, disabled)):
        for size in (16, 20, 24, 32, 40, 48):
            result.addPixmap(_pixmap(name, size, ink, 1.0), mode)
    return result


def pixmap(name: str, size: int, color: str = "", ratio: float = 1.0) -> QPixmap:
    """Return the icon at `size` logical pixels for a screen of `ratio` device pixels each."""
    color = color or look.palette.text
    made = _pixmap(name, size, color, ratio)
    _drawn[made.cacheKey()] = (name, color)
    return made


@cache
def _pixmap(name: str, size: int, color: str, ratio: float) -> QPixmap:
    edge = round(size * ratio)
    drawn = QPixmap(QSize(edge, edge))
    drawn.fill(Qt.GlobalColor.transparent)
    painter = QPainter(drawn)
    QSvgRenderer(QByteArray(icons.svg(name, color).encode())).render(
        painter, QRectF(0, 0, edge, edge)
    )
    painter.end()
    drawn.setDevicePixelRatio(ratio)
    return drawn


def _redraw_icons(app: QApplication, old: Palette, new: Palette) -> None:
    """Give all icons and signs in the windows the colours of another palette."""
    inks: dict[str, str] = {}
    for field in dataclasses.fields(Palette):
        inks.setdefault(getattr(old, field.name), getattr(new, field.name))
    for widget in app.allWidgets():
        for owner in (widget, *widget.actions()):
            if isinstance(owner, QAbstractButton | QAction):
                known = _drawn.get(owner.icon().cacheKey())
                if known is not None:
                    owner.setIcon(icon(known[0], inks.get(known[1], "")))
        if isinstance(widget, QLabel):
            _redraw_sign(widget, inks)
        elif isinstance(widget, QComboBox):
            for i in range(widget.count()):
                known = _drawn.get(widget.itemIcon(i).cacheKey())
                if known is not None:
                    widget.setItemIcon(i, icon(known[0], inks.get(known[1], "")))
        elif isinstance(widget, QListWidget):
            for item in (widget.item(i) for i in range(widget.count())):
                known = _drawn.get(item.icon().cacheKey())
                if known is not None:
                    item.setIcon(icon(known[0], inks.get(known[1], "")))


def _redraw_sign(label: QLabel, inks: dict[str, str]) -> None:
    shown = label.pixmap()
    known = None if shown.isNull() else _drawn.get(shown.cacheKey())
    if known is not None:
        ratio = shown.devicePixelRatio()
        size = round(shown.width() / ratio)
        label.setPixmap(pixmap(known[0], size, inks.get(known[1], ""), ratio))
