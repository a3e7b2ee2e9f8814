"""The tokens of the people of a project: who a browser is.

`.std/tokens.json` holds a digest of each token, never the token: whoever reads the file cannot use
it. A token is 32 random bytes, so that a plain digest cannot be searched.
"""

from __future__ import annotations

import hashlib
import hmac
import secrets
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import msgspec

from std_toolkit.errors import ToolkitError, check_known
from std_toolkit.html.table import Table, text_table
from std_toolkit.io.documents import read_document, utc_text, write_document
from std_toolkit.project.record import Project
from std_toolkit.scene.document import Document, check_unique
from std_toolkit.scene.pose_model import Time
from std_toolkit.scene.review import Person

FILE = Path(".std") / "tokens.json"
_BYTES = 32


class Token(Document, frozen=True, kw_only=True):
    """The token of one person.

    Attributes:
        person: of the project.
        digest: SHA-256 of the token, hexadecimal.
        time: when it was made, UTC, ISO 8601.
    """

    person: Person
    digest: Annotated[str, msgspec.Meta(pattern="^[0-9a-f]{64}$")]
    time: Time


class Tokens(Document, frozen=True, kw_only=True):
    """.std/tokens.json: at most one token a person; a revoked one has no row."""

    tokens: list[Token] = msgspec.field(default_factory=list)

    def check(self) -> None:
        check_unique([t.person for t in self.tokens], "tokens", "person")


def read_tokens(project: Project) -> Tokens:
    """The tokens of a project; empty without any.

    Raises:
        ToolkitError: the file is damaged.
    """
    path = project.root / FILE
    return read_document(path, Tokens) if path.is_file() else Tokens()


def make_token(project: Project, person: str) -> str:
    """Make the token of a person, which replaces an earlier one, and return it: it is not stored.

    Raises:
        ToolkitError: nobody of the project has this name, or the file cannot be written.
    """
    check_person(project, person)
    token = secrets.token_urlsafe(_BYTES)
    _replace(project, person, Token(person=person, digest=_digest(token), time=utc_text()))
    return token


def revoke_token(project: Project, person: str) -> None:
    """Make the token of a person worthless; a server that runs notices within seconds.

    Raises:
        ToolkitError: the person has none, or the file cannot be written.
    """
    known = [t.person for t in read_tokens(project).tokens]
    check_known(person, known, "has no token", path=project.root, field="--revoke")
    _replace(project, person, None)


def _replace(project: Project, person: str, new: Token | None) -> None:
    with project.locked():
        others = [t for t in read_tokens(project).tokens if t.person != person]
        found = Tokens(tokens=[*others, new] if new is not None else others)
        write_document(project.root / FILE, found)


def check_person(project: Project, person: str) -> None:
    """Check that a project names a person.

    Raises:
        ToolkitError: it does not.
    """
    if not project.record.people:
        raise ToolkitError(
            "the project names no people",
            path=project.root,
            hint="add them with `std-curate project add PROJECT --people NAME ...`",
        )
    check_known(person, project.record.people, "the project has no such person", path=project.root)


def _digest(token: str) -> str:
    return hashlib.sha256(token.encode(errors="replace")).hexdigest()


@dataclass
class Doorkeeper:
    """Says who a token belongs to now; the file is read again when it changed.

    Attributes:
        project: whose people have the tokens.
        guests: tokens that hold as long as this object: person by token.
    """

    project: Project
    guests: dict[str, str]

    def __post_init__(self) -> None:
        self._known: Tokens | None = None
        self._state: tuple[int, int, int] | None = None

    def person_of(self, token: str) -> str | None:
        """The person, or None if the token is worthless.

        Raises:
            ToolkitError: the file is damaged; then nobody comes in.
        """
        digest, found = _digest(token), None
        rows = [(t.person, t.digest) for t in self._tokens().tokens]
        rows += [(person, _digest(guest)) for guest, person in self.guests.items()]
        for person, known in rows:  # all of them: the time tells nothing
            if hmac.compare_digest(digest, known) and person in self.project.record.people:
                found = person
        return found

    def _tokens(self) -> Tokens:
        try:
            found = (self.project.root / FILE).stat()
        except OSError:
            self._state, self._known = None, Tokens()
            return self._known
        state = (found.st_mtime_ns, found.st_size, found.st_ino)
        if self._known is None or state != self._state:
            self._known, self._state = read_tokens(self.project), state
        return self._known


def people_table(project: Project) -> Table:
    """One row per person: since when they have a token."""
    since = {t.person: t.time for t in read_tokens(project).tokens}
    words = ("person", "token since")
    cells = [(name, since.get(name, "none")) for name in project.record.people]
    return text_table(words, cells, texts=words)
