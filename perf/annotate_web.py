"""Latency of a page of `std-annotate --web` while an object is dragged, in Chromium.

    python perf/annotate_web.py [--moves 40]

The scene of perf/annotate_redraw.py (1280x720, six objects of 50,000 faces) is served, and an
object is dragged in a page of 1280x720 pixels. Printed are the time from a move of the pointer
until a picture drawn after it is on the page's canvas, and the size of the pictures.
"""

from __future__ import annotations

import argparse
import os
import re
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
from annotate_redraw import scene_with_depth

START_S = 120.0
BROWSERS = ("chromium", "chromium-browser", "google-chrome")
# Notes when a picture is on the canvas, and how large it was.
_WATCH = """() => {
    const view = document.querySelector("[data-view='0'] annotator-view");
    window.shownAt = []; window.bytes = [];
    const show = view.show.bind(view);
    view.show = (number, blob) => { window.bytes.push(blob.size); show(number, blob); };
    new MutationObserver(() => window.shownAt.push(performance.now()))
        .observe(view, { attributes: true, attributeFilter: ["data-shown"] });
}"""
# Moves the pointer as the browser would, and waits for the next picture.
_MOVE = """async ([x, y]) => {
    const view = document.querySelector("[data-view='0'] annotator-view");
    const count = window.shownAt.length, start = performance.now();
    view.pointed("move", { isPrimary: true, clientX: x, clientY: y, shiftKey: false,
                           ctrlKey: false, metaKey: false, altKey: false });
    while (window.shownAt.length === count && performance.now() - start < 10000)
        await new Promise((done) => setTimeout(done, 1));
    return [window.shownAt[count] - start, window.bytes[count]];
}"""


def measure(url: str, moves: int) -> None:
    from playwright.sync_api import sync_playwright

    program = next((path for name in BROWSERS if (path := shutil.which(name))), None)
    if program is None:
        raise SystemExit("needs Chromium")
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=program, args=["--no-sandbox"])
        page = browser.new_page(viewport={"width": 1280, "height": 720})
        page.set_default_timeout(120_000)
        page.goto(url)
        page.wait_for_selector("[data-view='0'] annotator-view[data-shown]")
        page.wait_for_timeout(6000)  # meshes, table and thumbnails
        page.evaluate(_WATCH)
        box = page.locator("[data-view='0']").bounding_box()
        assert box is not None
        x, y = box["x"] + box["width"] / 2, box["y"] + box["height"] / 2
        page.mouse.move(x, y)
        page.mouse.down()
        page.mouse.move(x + 6, y)
        page.wait_for_timeout(300)
        times, sizes = [], []
        for i in range(moves):
            shift = 6 + 30 * np.sin(i / 6)
            took, size = page.evaluate(_MOVE, [x + shift, y + 0.4 * shift])
            times.append(took)
            sizes.append(size)
            time.sleep(0.01)
        hint = page.locator("#hint").inner_text()
        page.mouse.up()
        browser.close()
    print(f"what the page says while dragging: {hint}")
    print(
        f"pointer to picture: median {np.median(times):.0f} ms, p90 {np.percentile(times, 90):.0f}"
    )
    kilobytes = np.array(sizes) / 1000
    print(f"a picture: median {np.median(kilobytes):.0f} kB, largest {kilobytes.max():.0f} kB")


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--moves", type=int, default=40)
    args = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        root, log = Path(folder) / "scene", Path(folder) / "log"
        scene_with_depth(root)
        environment = {k: v for k, v in os.environ.items() if k != "DISPLAY"}
        with log.open("w") as stderr:
            server = subprocess.Popen(
                [sys.executable, "-m", "annotator.cli", str(root), "--web", "0"],
                stderr=stderr, stdout=subprocess.DEVNULL, env=environment,
            )  # fmt: skip
        try:
            end = time.monotonic() + START_S
            while not (found := re.search(r"open (http://\S+) in", log.read_text())):
                if server.poll() is not None or time.monotonic() > end:
                    raise SystemExit(f"the server does not start: {log.read_text()}")
                time.sleep(0.1)
            measure(found[1], args.moves)
        finally:
            server.send_signal(signal.SIGINT)
            server.wait(timeout=60)
    return 0


if __name__ == "__main__":
    sys.exit(main())
