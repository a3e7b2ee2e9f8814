"""Messages over the views: they tell, and do not stop the work."""

from __future__ import annotations

from PySide6.QtCore import QEvent, QObject, Qt, QTimer
from PySide6.QtWidgets import QFrame, QHBoxLayout, QLabel, QToolButton, QVBoxLayout, QWidget

from annotator.desk.events import Level
from annotator.window import theme
from annotator.window.icons import icon, pixmap

# Long enough to read; errors stay until they are closed or newer messages replace them.
SHOWN_MS: dict[Level, int] = {"info": 8000, "warning": 20_000}
MOST = 3
WIDEST = 680
MARGIN = 10
_INK: dict[Level, str] = {"info": theme.ACCENT, "warning": theme.WARNING, "error": theme.BAD}


class Banner(QWidget):
    """The latest messages, newest below; hidden while there are none.

    It floats over the foot of a widget: the views keep their place and size.
    """

    def __init__(self, over: QWidget) -> None:
        super().__init__(over)
        self._over = over
        over.installEventFilter(self)
        self._layout = QVBoxLayout(self)
        self._layout.setContentsMargins(0, 0, 0, 0)
        self._layout.setSpacing(2)
        self.messages: list[Message] = []
        self.hide()

    def tell(self, text: str, level: Level = "info") -> None:
        """Show a message; the same one again is not shown twice."""
        for old in list(self.messages):
            # News of success and progress replace each other.
            if old.text == text or (old.level == "info" and level == "info"):
                self._remove(old)
        message = Message(text, level)
        message.close_button.clicked.connect(lambda: self._remove(message))
        if level in SHOWN_MS:
            QTimer.singleShot(SHOWN_MS[level], message, lambda: self._remove(message))
        self.messages.append(message)
        self._layout.addWidget(message)
        # Until it is shown the layout has no room for it.
        message.show()
        while len(self.messages) > MOST:
            self._remove(self.messages[0])
        self._arrange()

    def eventFilter(self, watched: QObject, event: QEvent) -> bool:
        if watched is self._over and event.type() == QEvent.Type.Resize:
            self._arrange()
        return super().eventFilter(watched, event)

    def _arrange(self) -> None:
        """At the foot, as wide as is easy to read."""
        self.setVisible(bool(self.messages))
        if self.messages:
            width = min(self._over.width() - 2 * MARGIN, WIDEST)
            self.setFixedWidth(max(width, 200))
            self.adjustSize()
            height = self._layout.totalHeightForWidth(self.width())
            self.resize(self.width(), height if height > 0 else self.sizeHint().height())
            self.move(MARGIN, self._over.height() - self.height() - MARGIN)
            self.raise_()

    def clear(self) -> None:
        for message in list(self.messages):
            self._remove(message)

    def _remove(self, message: Message) -> None:
        if message in self.messages:
            self.messages.remove(message)
            self._layout.removeWidget(message)
            message.hide()
            message.deleteLater()
        self._arrange()


class Message(QFrame):
    """One message: what it is by a coloured edge and an icon."""

    def __init__(self, text: str, level: Level) -> None:
        super().__init__()
        self.text, self.level = text, level
        self.setObjectName("message")
        self.setStyleSheet(
            f"QFrame#message {{ background: {theme.RAISED}; border: 1px solid {theme.BORDER};"
            f" border-left: 3px solid {_INK[level]}; }}"
        )
        sign = QLabel()
        sign.setPixmap(pixmap(level, 16, _INK[level], self.devicePixelRatioF()))
        label = QLabel(text)
        label.setTextFormat(Qt.TextFormat.PlainText)
        label.setWordWrap(True)
        label.setTextInteractionFlags(Qt.TextInteractionFlag.TextSelectableByMouse)
        self.close_button = QToolButton()
        self.close_button.setIcon(icon("close", theme.MUTED))
        self.close_button.setToolTip("Close this message")
        self.close_button.setFocusPolicy(Qt.FocusPolicy.NoFocus)
        row = QHBoxLayout(self)
        row.setContentsMargins(8, 4, 4, 4)
        row.addWidget(sign, 0, Qt.AlignmentFlag.AlignTop)
        row.addWidget(label, 1)
        row.addWidget(self.close_button, 0, Qt.AlignmentFlag.AlignTop)
