"""The open scenes of a project's server: each is a `std-annotate` of its own process.

A session that ends in any way, `kill -9` included, takes no other with it and loses no edit: its
journal is on disk. It listens on loopback with a token that only this server knows, and ends with
this server, because its standard input does.
"""

from __future__ import annotations

import asyncio
import os
import re
import secrets
import sys
import time
from asyncio.subprocess import DEVNULL, PIPE, Process
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

from annotator.options import HOME_VARIABLE, TOKEN_VARIABLE
from annotator.web.guard import COOKIE
from std_toolkit.log import logger

# Edit a scene, look at it without a lock, or label its second copy, blind.
Mode = Literal["edit", "look", "again"]

_ADDRESS = re.compile(r"open http://127\.0\.0\.1:(\d+)")
# A session that does not end when it is asked to is killed after this time, seconds: it may write.
_PATIENCE_S = 60.0


@dataclass
class SceneSession:
    """A scene that a person has open.

    Attributes:
        mode, name: of the scene in the project.
        person: who opened it.
        folder: of the scene or its copy.
        take_over: whether to take it from a computer that is gone.
        since: when it was opened, seconds since 1970.
        ready: set when it listens, or when it ended before that.
        port: that it listens on; 0 before, and after its end.
        sockets: how many web sockets of pages are open.
        left: since when there is none, seconds of a monotonic clock.
        problem: why it could not be opened; "" otherwise.
        died: whether it ended although nobody asked it to.
    """

    mode: Mode
    name: str
    person: str
    folder: Path
    take_over: bool = False
    since: float = field(default_factory=time.time)
    ready: asyncio.Event = field(default_factory=asyncio.Event)
    port: int = 0
    sockets: int = 0
    left: float = field(default_factory=time.monotonic)
    problem: str = ""
    died: bool = False
    token: str = field(default_factory=lambda: secrets.token_urlsafe(24))
    process: Process | None = None
    asked_to_end: bool = False

    @property
    def running(self) -> bool:
        """Whether its process runs or begins."""
        return not self.died and not self.problem and not self.asked_to_end

    @property
    def headers(self) -> dict[str, str]:
        """What its server wants to see."""
        host = f"127.0.0.1:{self.port}"
        return {"Host": host, "Cookie": f"{COOKIE}_{self.port}={self.token}"}

    @contextmanager
    def connected(self) -> Iterator[None]:
        """Count a web socket while it is open."""
        self.sockets += 1
        try:
            yield
        finally:
            self.sockets -= 1
            self.left = time.monotonic()


Key = tuple[str, Mode, str]


class SceneSessions:
    """All sessions of a server, by person, mode and scene.

    Args:
        idle_s: a session without a page ends after this time, seconds.
    """

    def __init__(self, *, idle_s: float) -> None:
        self._idle_s = idle_s
        self._all: dict[Key, SceneSession] = {}
        self._tasks: set[asyncio.Task[None]] = set()

    def find(self, person: str, mode: Mode, name: str) -> SceneSession | None:
        """The session of a person, also one that died."""
        return self._all.get((person, mode, name))

    def editor(self, mode: Mode, name: str) -> SceneSession | None:
        """The session that edits a scene or its copy now; at most one does."""
        found = (s for s in self._all.values() if (s.mode, s.name) == (mode, name) and s.running)
        return next(found, None) if mode != "look" else None

    def of(self, person: str) -> list[SceneSession]:
        """The sessions of a person that run."""
        return [s for s in self._all.values() if s.person == person and s.running]

    async def open(
        self, person: str, mode: Mode, name: str, folder: Path, *, take_over: bool = False
    ) -> SceneSession:
        """Open a scene, or find it open, and wait until it can be shown or failed.

        Args:
            take_over: from a computer that is gone, see `hold_lock`.
        """
        key = (person, mode, name)
        known = self._all.get(key)
        if known is None or not known.running:
            known = self._all[key] = SceneSession(mode, name, person, folder, take_over)
            task = asyncio.create_task(self._run(known))
            self._tasks.add(task)
            task.add_done_callback(self._tasks.discard)
        await known.ready.wait()
        return known

    async def _run(self, session: SceneSession) -> None:
        try:
            await self._live(session)
        except OSError as error:
            session.problem = f"cannot start a process: {error}"
        finally:
            session.ready.set()

    async def _live(self, session: SceneSession) -> None:
        words = [sys.executable, "-m", "annotator.cli", str(session.folder), "--web", "0"]
        words += [f"--annotator={session.person}"]
        words += ["--read-only"] if session.mode == "look" else []
        words += ["--take-over"] if session.take_over and session.mode != "look" else []
        known = {TOKEN_VARIABLE: session.token, HOME_VARIABLE: "../../../"}
        session.process = process = await asyncio.create_subprocess_exec(
            *words, stdin=PIPE, stdout=DEVNULL, stderr=PIPE, env={**os.environ, **known},
            start_new_session=True,
        )  # fmt: skip
        assert process.stderr is not None
        last = error = ""
        try:
            async for line in process.stderr:
                last = line.decode(errors="replace").strip() or last
                logger.debug("%s (%s): %s", session.name, session.person, last)
                error = last.removeprefix("error: ") if last.startswith("error: ") else error
                address = _ADDRESS.search(last)
                if address and not session.port:
                    session.port = int(address[1])
                    session.ready.set()
            status = await process.wait()
        finally:
            was_ready, session.port = session.port > 0, 0
        if not was_ready:
            session.problem = error or last or "it ended before it began"
        elif session.asked_to_end or status in (0, 130, 143):
            session.asked_to_end = True
        else:
            session.died = True
            logger.warning(
                "the session of %s in %s ended unexpectedly (status %d); no edit is lost",
                session.person, session.name, status,
            )  # fmt: skip

    async def end(self, session: SceneSession) -> None:
        """Ask a session to end and wait for it; its unsaved edits stay in the journal."""
        session.asked_to_end = True
        process = session.process
        if process is None or process.returncode is not None:
            return
        with suppress(ProcessLookupError):
            process.terminate()
        try:
            await asyncio.wait_for(process.wait(), _PATIENCE_S)
        except TimeoutError:
            with suppress(ProcessLookupError):
                process.kill()

    async def end_idle(self) -> None:
        """End the sessions that no page has shown for a while."""
        now = time.monotonic()
        for session in list(self._all.values()):
            if session.port and not session.sockets and now - session.left > self._idle_s:
                logger.info("%s: closed, %s left it", session.name, session.person)
                await self.end(session)

    async def end_of_others(self, people: set[str]) -> None:
        """End the sessions of all but some people."""
        for session in list(self._all.values()):
            if session.running and session.person not in people:
                logger.info("%s: closed, %s has no token now", session.name, session.person)
                await self.end(session)

    async def close(self) -> None:
        """End all sessions."""
        await asyncio.gather(*(self.end(s) for s in self._all.values()))
        await asyncio.gather(*self._tasks)
