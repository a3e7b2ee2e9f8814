"""Makes docs/pictures/report.jpg: the top of a report, as Chromium shows it.

make demo && python docs/pictures/report_page.py build/demo/benchmark/report.html
"""

from __future__ import annotations

import shutil
import sys
from pathlib import Path

import cv2
import numpy as np
from playwright.sync_api import sync_playwright

OUT = Path(__file__).with_name("report.jpg")
WIDTH, HEIGHT = 1240, 1580


def main(page_file: Path) -> None:
    program = shutil.which("chromium") or shutil.which("google-chrome")
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=program, args=["--no-sandbox"])
        page = browser.new_page(viewport={"width": WIDTH, "height": HEIGHT})
        page.goto(page_file.resolve().as_uri())
        page.wait_for_selector(".plot .main-svg")
        page.wait_for_timeout(1000)  # figures fade in
        png = page.screenshot()
        browser.close()
    image = cv2.imdecode(np.frombuffer(png, np.uint8), cv2.IMREAD_COLOR)
    cv2.imwrite(str(OUT), image, [cv2.IMWRITE_JPEG_QUALITY, 85])


if __name__ == "__main__":
    main(Path(sys.argv[1]))
