"""Fixtures that all tests share."""

from __future__ import annotations

import fcntl
import gc
import json
import os
import shutil
import sys
from collections.abc import Callable, Generator, Iterator
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from tests.skips import program_missing, refuse_report
from tests.timings import Timings

if TYPE_CHECKING:
    from playwright.sync_api import Browser, Page

BROWSERS = ("chromium", "chromium-browser", "google-chrome")
REPOSITORY = Path(__file__).resolve().parent.parent
TIMINGS = Timings()

if sys.dont_write_bytecode and sys.pycache_prefix is None:
    # Nothing is written beside the sources then. Compiling all tests anew, with pytest's rewritten
    # assertions, takes half of the processor time of a collection.
    sys.pycache_prefix = str(REPOSITORY / ".pytest_cache" / "bytecode")
    sys.dont_write_bytecode = False
if "PYTEST_XDIST_WORKER" in os.environ:
    # Each worker has a core; more threads would only wait for each other. Read at first imports.
    os.environ.setdefault("OMP_NUM_THREADS", "1")


@pytest.hookimpl(wrapper=True)
def pytest_collection() -> Generator[None, object, object]:
    """Collect without garbage collection, which takes a quarter of the time and finds nothing."""
    gc.disable()
    try:
        return (yield)
    finally:
        gc.enable()
        gc.freeze()


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Files with slow tests first, so that all workers end at about the same time.

    Not where the order is to be random.
    """
    if "PYTEST_XDIST_WORKER" in os.environ and not config.pluginmanager.hasplugin("randomly"):
        slow = {item.path for item in items if item.get_closest_marker("slow")}
        items.sort(key=lambda item: item.path not in slow)


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport() -> Generator[None, pytest.TestReport, pytest.TestReport]:
    """In continuous integration few skips are allowed; what each test costs is written down."""
    report = yield
    refuse_report(report)
    report.processor_s = TIMINGS.lap()
    return report


def pytest_runtest_logreport(report: pytest.TestReport) -> None:
    """Count what a test cost, in this process or in a worker."""
    before = sum(TIMINGS.spent_s.values())
    TIMINGS.add(report.nodeid, getattr(report, "processor_s", 0.0))
    # Every ten minutes of a long run; the machine may have been slow only for a while.
    if "PYTEST_XDIST_WORKER" not in os.environ and (
        sum(TIMINGS.spent_s.values()) // 600 > before // 600
    ):
        TIMINGS.measure_slowness()


def pytest_collection_finish() -> None:
    """The collection counts for no test."""
    TIMINGS.lap()


def pytest_sessionfinish(session: pytest.Session) -> None:
    """A run over its budget fails; long tests have none, and coverage slows all tests down."""
    config = session.config
    free = config.option.markexpr == "long" or config.pluginmanager.hasplugin("_cov")
    if not free and "PYTEST_XDIST_WORKER" not in os.environ and TIMINGS.over():
        session.exitstatus = session.exitstatus or pytest.ExitCode.TESTS_FAILED


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter) -> None:
    """The costs, where a run is long enough to have some."""
    if sum(TIMINGS.spent_s.values()) > 60:
        terminalreporter.section("processor time by package")
        for line in TIMINGS.table():
            terminalreporter.write_line(line)
        for name in TIMINGS.over():
            terminalreporter.write_line(f"over the budget of tests/timings.py: {name}", red=True)


@pytest.hookimpl(wrapper=True)
def pytest_make_collect_report() -> Generator[None, pytest.CollectReport, pytest.CollectReport]:
    """The same for files that are skipped as a whole."""
    report = yield
    refuse_report(report)
    return report


MakeOnce = Callable[[str, Callable[[Path], object]], Path]


@pytest.fixture(autouse=True)
def no_plugins_of_other_tests(monkeypatch: pytest.MonkeyPatch) -> None:
    """Errors name the plug-in that is in use, and a command is a process of its own."""
    from std_toolkit import plugins

    monkeypatch.setattr(plugins, "_loaded_from", {})


@pytest.fixture(scope="session")
def made_once(tmp_path_factory: pytest.TempPathFactory) -> MakeOnce:
    """Makes a folder that all processes of a run of the tests share, when the first asks for it.

    Called with a name and with what fills the folder of the path that it is given. Nobody may
    change what is in there.
    """
    top = tmp_path_factory.getbasetemp()
    if "PYTEST_XDIST_WORKER" in os.environ:
        top = top.parent

    def make(name: str, fill: Callable[[Path], object]) -> Path:
        folder = top / "shared" / name
        folder.parent.mkdir(exist_ok=True)
        with folder.with_suffix(".lock").open("w") as lock:
            fcntl.flock(lock, fcntl.LOCK_EX)
            done = folder.with_suffix(".done")
            if not done.exists():
                shutil.rmtree(folder, ignore_errors=True)  # of one who failed
                fill(folder)
                done.touch()
        return folder

    return make


@pytest.fixture(scope="session")
def test_data() -> Path:
    """Folder of the real recordings, which may not be redistributed."""
    folder = Path(os.environ.get("STD_TEST_DATA", REPOSITORY.parent / "shared" / "data"))
    if not folder.is_dir():
        pytest.skip(f"real recordings not found at {folder}; set STD_TEST_DATA to their folder")
    return folder


@pytest.fixture(scope="module")
def browser() -> Iterator[Browser]:
    """The system's Chromium without a window.

    While it runs, playwright has this thread's event loop: `asyncio.run` works in modules without.
    """
    from playwright.sync_api import sync_playwright

    program = next((path for name in BROWSERS if (path := shutil.which(name))), None)
    if program is None:
        program_missing("Chromium", "chromium")
    with sync_playwright() as playwright:
        # Its sandbox needs rights that containers and root do not have; the pages are ours.
        running = playwright.chromium.launch(executable_path=program, args=["--no-sandbox"])
        yield running
        running.close()


@pytest.fixture
def page(browser: Browser) -> Iterator[Page]:
    """An empty page of 1280x720 pixels in a browser profile of its own."""
    context = browser.new_context(viewport={"width": 1280, "height": 720})
    yield context.new_page()
    context.close()


@pytest.fixture(scope="session")
def tiny_dreds(made_once: MakeOnce) -> Path:
    """A simulated data set in the DREDS layout: one scene, two views of 160x90, four objects.

    Returns the folder that `std-sim --out` would have written: `DREDS-CatKnown/train/00000`,
    `cad_model`, `parameters`, `simulation.json`. It is made once per session, in a process of its
    own, in about 15 s of processor time, less where the convex parts of its shapes are kept; so
    mark tests that need it `slow`, and copy it before changing anything in it.
    """
    for package in ("mitsuba", "mujoco", "coacd", "manifold3d"):
        if find_spec(package) is None:
            pytest.skip(f"the simulator's extra is not installed: no {package}")
    from sensors.simulation.options import SimulationOptions
    from sensors.simulation.simulated_set import simulate_set
    from std_toolkit.jobs import JobOptions

    options = SimulationOptions(
        views=2, width=160, height=90, quality="rough", min_objects=1, max_objects=4
    )

    def simulate(out: Path) -> None:
        # Not in this process: the tracer stays out of sessions that load torch or Qt.
        jobs = JobOptions(workers=1, progress=False)
        simulate_set(out, options, [0], jobs=jobs).raise_if_failed()

    return made_once("tiny-dreds", simulate)


@pytest.fixture(scope="session")
def synthetic_table(made_once: MakeOnce) -> Path:
    """A synthetic recording of six objects on a table: nine frames over 120 degrees.

    As many as a refinement looks at. It is made once per session, in about 15 s, so mark tests that
    need it `slow`; nothing in it may be changed.
    """
    from sensors.synthetic import RecordingOptions, make_recording

    options = RecordingOptions(frames=9, seed=1)
    return made_once("synthetic-table", lambda out: make_recording(out, options))


@pytest.fixture(scope="session")
def tabletop_poses(test_data: Path, made_once: MakeOnce) -> Path:
    """A scene of the real recording on the printed board, its camera poses recovered from colour.

    Their scale is not known; in a copy, `estimate_poses` with a source of it takes seconds. It is
    made once per session, in about 40 s, so mark tests that need it `slow`, and copy it (with
    `symlinks=True`) before changing anything in it. Frames are numbered as its images are.
    """
    source = test_data / "tabletop_board_rgb"
    if not source.is_dir():
        pytest.skip(f"{source} not found")
    from std_toolkit.options import PoseOptions
    from std_toolkit.poses.pose_step import estimate_poses
    from std_toolkit.scene import CameraModel, Frame, Frames, Scene, SceneInfo

    def recover(root: Path) -> None:
        root.mkdir()
        (root / "color").symlink_to(source / "color")
        K = json.loads((source / "cam_intrinsics.json").read_text())["K"]
        camera = CameraModel(width=1280, height=720, fx=K[0][0], fy=K[1][1], cx=K[0][2], cy=K[1][2])
        frames = [
            Frame(id=int(f.stem), name=f.stem, color=f"color/{f.name}")
            for f in sorted((source / "color").glob("*.jpg"))
        ]
        info = SceneInfo(name="tabletop", cameras={"color": camera})
        scene = Scene.create(root, info, Frames(frames=frames))
        estimate_poses(scene, PoseOptions(scale="none"))

    return made_once("tabletop", recover)
