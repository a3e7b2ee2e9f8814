"""Theme and icons of the window, in neutral greys to avoid a colour bias."""

from __future__ import annotations

from functools import cache

from PySide6.QtCore import QByteArray, QRectF, QSize, Qt
from PySide6.QtGui import QColor, QIcon, QPainter, QPalette, QPixmap
from PySide6.QtSvg import QSvgRenderer
from PySide6.QtWidgets import QApplication, QStyleFactory

from annotator.app import events, icons, object_summary

BASE = "#1f1f1f"

WINDOW = "#2a2a2a"

RAISED = "#353535"

HOVER = "#414141"


BORDER = "#464646"

TEXT = "#e4e4e4"

MUTED = "#a0a0a0"

FAINT = "#747474"

ACCENT = "#6ea8dc"

ACCENT_DEEP = "#3d6d99"

GOOD, WARNING, BAD = "#6fbf84", "#e0b050", "#e8776a"

GRADE_INK: dict[object_summary.Grade, str] = {
    "fits": GOOD,
    "doubtful": WARNING,
    "wrong": BAD,
    "unknown": MUTED,
}

LEVEL_INK: dict[events.Level, str] = {"info": ACCENT, "warning": WARNING, "error": BAD}

_STYLE = f"""
QToolTip {{ color: {TEXT}; background: {RAISED}; border: 1px solid {BORDER}; padding: 4px 6px; }}
QMenuBar {{ background: {WINDOW}; padding: 1px 4px; }}
QMenuBar::item {{ padding: 3px 8px; border-radius: 3px; }}
QMenuBar::item:selected {{ background: {HOVER}; }}
QMenu {{ background: {RAISED}; border: 1px solid {BORDER}; padding: 4px; }}
QMenu::item {{ padding: 4px 22px 4px 24px; border-radius: 3px; }}
QMenu::item:selected {{ background: {ACCENT_DEEP}; }}
QMenu::item:disabled {{ color: {FAINT}; }}
QMenu::separator {{ height: 1px; background: {BORDER}; margin: 4px 6px; }}
QMenu::indicator {{ width: 14px; height: 14px; margin-left: 5px; }}
QToolBar {{ background: {WINDOW}; border: 0; border-bottom: 1px solid {BORDER};
  spacing: 1px; padding: 2px 4px; }}
QWidget#line {{ background: {BORDER}; }}
QToolButton {{ border: 1px solid transparent; border-radius: 4px; padding: 3px; }}
QToolButton:hover {{ background: {HOVER}; }}
QToolButton:checked {{ background: {ACCENT_DEEP}; border-color: {ACCENT}; }}
QToolButton:disabled {{ color: {FAINT}; }}
QToolButton#labelled {{ padding: 3px 7px 3px 5px; }}
QPushButton {{ background: {RAISED}; border: 1px solid {BORDER}; border-radius: 4px;
  padding: 4px 10px; }}
QPushButton:hover {{ background: {HOVER}; }}
QPushButton:pressed {{ background: {BASE}; }}
QPushButton:disabled {{ color: {FAINT}; background: {WINDOW}; }}
QPushButton:default, QPushButton#primary {{ background: {ACCENT_DEEP}; border-color: {ACCENT}; }}
QPushButton:default:disabled, QPushButton#primary:disabled {{ background: {WINDOW};
  border-color: {BORDER}; }}
QPushButton:focus {{ border-color: {ACCENT}; }}
QLineEdit, QPlainTextEdit {{ background: {BASE};
  border: 1px solid {BORDER}; border-radius: 3px; padding: 2px 4px;
  selection-background-color: {ACCENT_DEEP}; }}
QAbstractSpinBox QLineEdit {{ border: 0; padding: 0; background: transparent; }}
QLineEdit:focus, QPlainTextEdit:focus {{ border-color: {ACCENT}; }}
QLineEdit:disabled {{ color: {FAINT}; background: {WINDOW}; }}
QComboBox QAbstractItemView {{ background: {RAISED}; border: 1px solid {BORDER};
  selection-background-color: {ACCENT_DEEP}; }}
QAbstractItemView {{ background: {BASE}; border: 1px solid {BORDER}; border-radius: 3px;
  outline: 0; }}
QHeaderView::section {{ background: {WINDOW}; color: {MUTED}; border: 0;
  border-bottom: 1px solid {BORDER}; padding: 2px 4px; }}
QTableView {{ gridline-color: {WINDOW}; selection-background-color: {ACCENT_DEEP}; }}
QRadioButton::indicator, QCheckBox::indicator {{ width: 12px; height: 12px;
  border: 1px solid {FAINT}; background: {BASE}; }}
QRadioButton::indicator {{ border-radius: 7px; }}
QCheckBox::indicator {{ border-radius: 3px; }}
QRadioButton::indicator:hover, QCheckBox::indicator:hover {{ border-color: {ACCENT}; }}
QRadioButton::indicator:checked, QCheckBox::indicator:checked {{ border-color: {ACCENT};
  background: qradialgradient(cx:0.5, cy:0.5, radius:0.5, fx:0.5, fy:0.5, stop:0 {TEXT},
  stop:0.55 {TEXT}, stop:0.65 {ACCENT_DEEP}, stop:1 {ACCENT_DEEP}); }}
QRadioButton::indicator:disabled, QCheckBox::indicator:disabled {{ border-color: {BORDER};
  background: {WINDOW}; }}
QRadioButton::indicator:checked:disabled, QCheckBox::indicator:checked:disabled {{
  background: {FAINT}; }}
QTabWidget::pane {{ border: 0; border-top: 1px solid {BORDER}; }}
QTabBar::tab {{ padding: 4px 10px; color: {MUTED}; border-bottom: 2px solid transparent; }}
QTabBar::tab:selected {{ color: {TEXT}; border-bottom-color: {ACCENT}; }}
QTabBar::tab:hover {{ color: {TEXT}; }}
QSplitter::handle {{ background: {WINDOW}; }}
QSplitter::handle:hover {{ background: {HOVER}; }}
QScrollBar {{ background: transparent; border: 0; }}
QScrollBar:vertical {{ width: 10px; }}
QScrollBar:horizontal {{ height: 10px; }}
QScrollBar::handle {{ background: {HOVER}; border-radius: 4px; margin: 1px; min-height: 24px;
  min-width: 24px; }}
QScrollBar::handle:hover {{ background: {FAINT}; }}
QScrollBar::add-line, QScrollBar::sub-line, QScrollBar::add-page, QScrollBar::sub-page {{
  background: transparent; border: 0; width: 0; height: 0; }}
QSlider::groove:horizontal {{ height: 4px; background: {BASE}; border-radius: 2px; }}
QSlider::sub-page:horizontal {{ background: {ACCENT_DEEP}; border-radius: 2px; }}
QSlider::handle:horizontal {{ width: 12px; height: 12px; margin: -4px 0; border-radius: 6px;
  background: {TEXT}; }}
QProgressBar {{ background: {BASE}; border: 1px solid {BORDER}; border-radius: 3px;
  text-align: center; max-height: 14px; }}
QProgressBar::chunk {{ background: {ACCENT_DEEP}; }}
QStatusBar {{ background: {WINDOW}; border-top: 1px solid {BORDER}; }}
QStatusBar::item {{ border: 0; }}
QLabel#muted {{ color: {MUTED}; }}
QLabel#heading {{ font-weight: 600; }}
QLabel#word {{ font-size: 17pt; font-weight: 600; }}
QPushButton#small {{ padding: 0px 6px; }}
QLabel#empty {{ color: {MUTED}; padding: 10px; }}
QLabel#title {{ font-size: 20pt; font-weight: 300; }}
QListWidget#roomy::item {{ padding: 5px 4px; border-radius: 3px; }}
QListWidget#roomy::item:hover {{ background: {HOVER}; }}
QFrame#card {{ background: {RAISED}; border: 1px solid {BORDER}; border-radius: 6px; }}
"""


def apply_theme(app: QApplication) -> None:
    """Apply the theme, based on Qt's Fusion style, which looks the same on every desktop."""
    app.setStyle(QStyleFactory.create("Fusion"))
    palette = QPalette()
    role = QPalette.ColorRole
    for target, color in {
        role.Window: WINDOW,
        role.WindowText: TEXT,
        role.Base: BASE,
        role.AlternateBase: WINDOW,
        role.ToolTipBase: RAISED,
        role.ToolTipText: TEXT,
        role.Text: TEXT,
        role.Button: RAISED,
        role.ButtonText: TEXT,
        role.BrightText: BAD,
        role.Link: ACCENT,
        role.Highlight: ACCENT_DEEP,
        role.HighlightedText: "#ffffff",
        role.PlaceholderText: FAINT,
    }.items():
        palette.setColor(target, QColor(color))
    for target in (role.WindowText, role.Text, role.ButtonText):
        palette.setColor(QPalette.ColorGroup.Disabled, target, QColor(FAINT))
    app.setPalette(palette)
    app.setStyleSheet(_STYLE)


@cache
def icon(name: str, color: str = TEXT) -> QIcon:
    """Return the icon of a name; an empty one if there is none."""
    if icons.ALIASES.get(name, name) not in icons.STROKES:
        return QIcon()
    result = QIcon()
    for mode, ink in ((QIcon.Mode.Normal, color), (QIcon.Mode.Disabled, FAINT)):
        for size in (16, 20, 24, 32, 40, 48):
            result.addPixmap(pixmap(name, size, ink), mode)
    return result


@cache
def pixmap(name: str, size: int, color: str = TEXT, ratio: float = 1.0) -> QPixmap:
    """Return the icon at `size` logical pixels for a screen of `ratio` device pixels each."""
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
