"""Web server of `std-annotate PROJECT --web PORT`: the board of a project, and its open scenes.

One address for all people of the project, each with a token. A scene that is opened is served by a
process of its own (`scene_sessions`), which this server passes requests on to: one port is enough.
"""

from __future__ import annotations

import asyncio
import hashlib
import secrets
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any, TypeVar, cast

from aiohttp import ClientError, ClientSession, DummyCookieJar, web

from annotator.app.mesh_folder import choose_folder
from annotator.app.review import review_question, store_review
from annotator.options import AnnotateOptions
from annotator.web.board_page import board_html, headers, scene_html
from annotator.web.guard import PERSON, guard, is_loopback
from annotator.web.reverse_proxy import pass_on
from annotator.web.scene_sessions import Mode, SceneSessions
from annotator.web.web_app import cannot_listen, tell_address, until_signal
from std_toolkit.checks.check_step import report_path
from std_toolkit.errors import ToolkitError, check_known
from std_toolkit.log import logger
from std_toolkit.project.cards import Cards, board_cards, scene_picture
from std_toolkit.project.people import Doorkeeper, read_tokens
from std_toolkit.project.queue import comment_scene
from std_toolkit.project.record import Project, ProjectScene
from std_toolkit.project.status import SceneRow, project_board

# A session without a page ends after this time; who comes back later opens it again.
IDLE_S = 600.0
# How long a board that was read is shown to others, and how often sessions are looked after.
FRESH_S, ROUND_S = 1.0, 1.0
WIDTHS = (360, 960)

_STATIC = Path(__file__).parent / "static"
# The report of a scene that others made runs its scripts in an origin of its own.
_REPORT_POLICY = (
    "sandbox allow-scripts; default-src 'none'; img-src data: blob:; style-src 'unsafe-inline'; "
    "script-src 'unsafe-inline' 'unsafe-eval'; base-uri 'none'; form-action 'none'; "
    "frame-ancestors 'none'"
)
_LARGEST_FORM = 256 * 1024

T = TypeVar("T")


def run(args: AnnotateOptions) -> int:
    """Serve a project until interrupted.

    Raises:
        ToolkitError: the project cannot be read, nobody has a token, an option is for a scene, or
            the port is in use.
        KeyboardInterrupt: SIGINT or SIGTERM ended the server.
    """
    assert args.scene is not None and args.web is not None  # ensured by the options
    if args.token is not None:
        raise ToolkitError(
            "in a project each person has a token",
            field="--token",
            hint="make them with `std-curate project people PROJECT --token NAME`",
        )
    project = Project.open(args.scene.resolve())
    guests = {}
    if args.annotator is not None:
        check_known(args.annotator, project.record.people, "the project has no such person",
                    path=project.root, field="--annotator")  # fmt: skip
        guests = {secrets.token_urlsafe(24): args.annotator}
    elif not read_tokens(project).tokens:
        raise ToolkitError(
            "nobody of the project has a token",
            path=project.root,
            hint="`std-curate project people PROJECT --token NAME` makes one; for one person, "
            "--annotator NAME does",
        )
    choose_folder(args.meshes)  # the sessions remember it
    server = BoardServer(project, guests)
    asyncio.run(until_signal(server.serve(host=args.host, port=args.web)))
    return 0


class BoardServer:
    """Serves the board and the sessions of one project.

    Args:
        project: the project.
        guests: tokens that hold as long as this server, person by token.
        idle_s: see `SceneSessions`.
    """

    def __init__(
        self, project: Project, guests: dict[str, str] | None = None, *, idle_s: float = IDLE_S
    ) -> None:
        self._project = project
        self._door = Doorkeeper(project, guests or {})
        self.sessions = SceneSessions(idle_s=idle_s)
        self._client: ClientSession | None = None
        self._reading = asyncio.Lock()
        self._rows: list[SceneRow] = []
        self._read_at = -1e9

    async def serve(
        self, *, host: str, port: int, started: Callable[[int], None] | None = None
    ) -> None:
        """Serve until cancelled; all sessions end with it.

        Args:
            started: called with the port once the server listens.
        """
        runner = web.AppRunner(self._app(loopback=is_loopback(host)), access_log=None)
        caring: asyncio.Task[None] | None = None
        async with ClientSession(auto_decompress=False, cookie_jar=DummyCookieJar()) as client:
            self._client = client
            await runner.setup()
            try:
                await web.TCPSite(runner, host, port).start()
                found = int(runner.addresses[0][1])
                tell_address(host, found, next(iter(self._door.guests), None), people=True)
                if started is not None:
                    started(found)
                caring = asyncio.create_task(self._care())
                await asyncio.Event().wait()
            except OSError as error:
                raise cannot_listen(error, host, port) from error
            finally:
                if caring is not None:
                    caring.cancel()
                await self.sessions.close()
                await runner.cleanup()

    def _app(self, *, loopback: bool) -> web.Application:
        app = web.Application(
            middlewares=[guard(self._person_of, loopback=loopback)], client_max_size=_LARGEST_FORM
        )
        app.router.add_get("/", self._board)
        app.router.add_static("/board", _STATIC)
        app.router.add_get("/scenes/{name}", self._scene)
        app.router.add_get("/scenes/{name}/picture", self._picture)
        app.router.add_get("/scenes/{name}/report", self._report)
        app.router.add_post("/scenes/{name}/open", self._open)
        app.router.add_post("/scenes/{name}/close", self._close)
        app.router.add_post("/scenes/{name}/review", self._review)
        app.router.add_post("/scenes/{name}/comment", self._comment)
        app.router.add_get("/at/{mode:edit|look|again}/{name}/{rest:.*}", self._pass_on)
        return app

    def _person_of(self, token: str) -> str | None:
        try:
            return self._door.person_of(token)
        except ToolkitError as error:
            logger.error("%s", error)
            return None

    async def _care(self) -> None:
        """End the sessions that nobody looks at, and those of people whose token was revoked."""
        while True:
            await asyncio.sleep(ROUND_S)
            try:
                await self.sessions.end_idle()
                known = {*self._door.guests.values()}
                known |= {t.person for t in read_tokens(self._project).tokens}
                await self.sessions.end_of_others(known)
            except ToolkitError as error:
                logger.error("%s", error)

    # --- pages -----------------------------------------------------------------------------------

    async def _read(self) -> list[SceneRow]:
        """The board, read in a thread; what was read a moment ago is read once for all."""
        async with self._reading:
            if time.monotonic() - self._read_at > FRESH_S:
                root = self._project.root
                try:
                    found = await _elsewhere(partial(Project.open, root))
                    self._rows = await _elsewhere(partial(project_board, found))
                except ToolkitError as error:
                    raise web.HTTPInternalServerError(text=f"{error}\n") from error
                self._project = self._door.project = found
                self._read_at = time.monotonic()
        return self._rows

    async def _cards(self, request: web.Request) -> Cards:
        return board_cards(self._project, await self._read(), request[PERSON])

    async def _board(self, request: web.Request) -> web.Response:
        cards = await self._cards(request)
        mine = [(s.mode, s.name) for s in self.sessions.of(cards.person)]
        version = hashlib.blake2b(repr((cards, mine)).encode(), digest_size=12).hexdigest()
        if request.headers.get("If-None-Match") == f'"{version}"':
            return web.Response(status=304)
        page = board_html(
            self._project, cards, self._rows, self.sessions.of(cards.person), version=version
        )
        return _page(page, ETag=f'"{version}"')

    async def _scene(
        self, request: web.Request, *, problem: str = "", status: int = 200, typed: Any = None
    ) -> web.Response:
        cards, (_, row) = await self._cards(request), await self._named(request)
        card = cards.cards[row.name]
        page = scene_html(
            self._project,
            cards,
            row,
            question=review_question(row, card, cards.person),
            sessions=self.sessions.of(cards.person),
            problem=problem,
            typed=typed or {},
        )
        return _page(page, status=status)

    async def _named(self, request: web.Request) -> tuple[ProjectScene, SceneRow]:
        name = request.match_info["name"]
        rows = await self._read()
        for item, row in zip(self._project.record.scenes, rows, strict=True):
            if item.name == name:  # never a path of the request
                return item, row
        raise web.HTTPNotFound(text="The project has no such scene.\n")

    async def _picture(self, request: web.Request) -> web.Response:
        _, row = await self._named(request)
        width = next((w for w in WIDTHS if request.query.get("width") == str(w)), WIDTHS[0])
        try:
            data = await _elsewhere(partial(scene_picture, self._project, row.scene, width=width))
        except ToolkitError:
            raise web.HTTPNotFound(text="The scene has no picture.\n") from None
        # The address has the version of the image.
        kept = {"Cache-Control": "private, max-age=86400, immutable"}
        return web.Response(body=data, content_type="image/jpeg", headers=kept)

    async def _report(self, request: web.Request) -> web.StreamResponse:
        item, _ = await self._named(request)
        path = report_path(self._project.folder(item))
        if not path.is_file():
            raise web.HTTPNotFound(text="The scene has no report: run the check.\n")
        told = {"Content-Security-Policy": _REPORT_POLICY, "Cache-Control": "no-store"}
        return web.FileResponse(path, headers=told)

    # --- what a person does ----------------------------------------------------------------------

    async def _open(self, request: web.Request) -> web.StreamResponse:
        item, row = await self._named(request)
        form = await request.post()
        mode = cast(Mode, str(form.get("mode", "look")))
        if mode not in ("edit", "look", "again"):
            raise web.HTTPBadRequest(text="A scene is opened to edit, look or again.\n")
        person = request[PERSON]
        other = self.sessions.editor(mode, row.name)
        if other is not None and other.person != person:
            since = time.strftime("%H:%M", time.localtime(other.since))
            told = f"{other.person} has {row.name} open since {since}; you can look at it meanwhile"
            return await self._scene(request, problem=told, status=409)
        copy = self._project.second(item)
        if mode == "again" and (row.second is None or not {*row.second.labellers} <= {person}):
            told = "There is no copy of this scene for you to label again."
            return await self._scene(request, problem=told, status=409)
        folder = copy if mode == "again" else self._project.folder(item)
        session = await self.sessions.open(
            person, mode, row.name, folder, take_over=form.get("take_over") == "1"
        )
        self._read_at = -1e9  # it holds the scene now
        if session.problem:
            return await self._scene(request, problem=session.problem, status=409)
        raise web.HTTPSeeOther(f"/at/{mode}/{row.name}/")

    async def _close(self, request: web.Request) -> web.StreamResponse:
        _, row = await self._named(request)
        for session in self.sessions.of(request[PERSON]):
            if session.name == row.name:
                await self.sessions.end(session)
        self._read_at = -1e9
        raise web.HTTPSeeOther(f"/scenes/{row.name}")

    async def _review(self, request: web.Request) -> web.StreamResponse:
        _, row = await self._named(request)
        answers = {key: str(value) for key, value in (await request.post()).items()}
        pressed, person = answers.pop("press", ""), request[PERSON]
        work = partial(store_review, self._project, row.name, person, pressed, answers)
        return await self._did(request, work, answers)

    async def _comment(self, request: web.Request) -> web.StreamResponse:
        _, row = await self._named(request)
        answers = {key: str(value) for key, value in (await request.post()).items()}
        work = partial(
            comment_scene, self._project, row.name, by=request[PERSON],
            text=answers.get("comment", ""),
        )  # fmt: skip
        return await self._did(request, work, answers)

    async def _did(
        self, request: web.Request, work: Callable[[], list[str] | None], answers: dict[str, str]
    ) -> web.StreamResponse:
        """Do something in a thread, and show the scene with what stands against it."""
        try:
            against = await _elsewhere(work)
        except ToolkitError as error:
            against = [error.problem]
        self._read_at = -1e9
        if against:
            told = "; ".join(against)
            return await self._scene(request, problem=told, status=409, typed=answers)
        raise web.HTTPSeeOther(f"/scenes/{request.match_info['name']}")

    # --- the sessions ----------------------------------------------------------------------------

    async def _pass_on(self, request: web.Request) -> web.StreamResponse:
        mode, name = cast(Mode, request.match_info["mode"]), request.match_info["name"]
        session = self.sessions.find(request[PERSON], mode, name)
        is_socket = "Upgrade" in request.headers
        if session is not None and session.died and not is_socket:
            # It was killed: the page that tries again finds a new one, with the journal.
            session = await self.sessions.open(session.person, mode, name, session.folder)
        if session is None or not session.running or not session.port:
            if is_socket:
                raise web.HTTPGone(text="The session has ended.\n")
            raise web.HTTPSeeOther("/")
        assert self._client is not None
        query = f"?{request.query_string}" if request.query_string else ""
        url = f"http://127.0.0.1:{session.port}/{request.match_info['rest']}{query}"
        work = pass_on(request, self._client, url, session.headers)
        try:
            if not is_socket:
                return await work
            with session.connected():
                return await work
        except ClientError:
            raise web.HTTPBadGateway(text="The session has ended.\n") from None


async def _elsewhere(work: Callable[[], T]) -> T:
    return await asyncio.get_running_loop().run_in_executor(None, work)


def _page(text: str, *, status: int = 200, **more: str) -> web.Response:
    told = headers() | {"Cache-Control": "no-cache"} | more
    return web.Response(text=text, status=status, content_type="text/html", headers=told)
