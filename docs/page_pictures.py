"""Take pictures of the page with every served bundle: `python docs/page_pictures.py URL FOLDER`.

Chromium opens it on a desktop and on a phone, light and dark, and `FOLDER` gets one PNG of each.
An error of the page, or a bundle that shows no anchors within a minute, exits with status 1.
"""

from __future__ import annotations

import itertools
import shutil
import sys
from pathlib import Path
from typing import Any, Literal

from playwright.sync_api import Page, sync_playwright

SCREENS: dict[str, Any] = {
    "desktop": {"viewport": {"width": 1440, "height": 900}},
    "phone": {"viewport": {"width": 390, "height": 844}, "has_touch": True, "is_mobile": True},
}
COLOURS: tuple[Literal["light", "dark"], ...] = ("light", "dark")
CHROMIUM = ("--no-sandbox", "--disable-gpu", "--disable-background-networking")
ANSWERED = "/[1-9]\\d* .*anchor/.test(document.querySelector('#summary').textContent)"


def main(url: str, folder: Path) -> None:
    """Write `FOLDER/BUNDLE-SCREEN-COLOUR.png` for every bundle that the page offers."""
    folder.mkdir(parents=True, exist_ok=True)
    errors: list[str] = []
    with sync_playwright() as playwright:
        path = shutil.which("chromium") or shutil.which("google-chrome")
        browser = playwright.chromium.launch(executable_path=path, args=[*CHROMIUM])
        for (screen, options), colour in itertools.product(SCREENS.items(), COLOURS):
            page = browser.new_page(color_scheme=colour, bypass_csp=True, **options)
            page.on("pageerror", lambda error: errors.append(str(error)))
            page.goto(url)
            for name in bundles(page):
                page.select_option("#bundle", name)
                page.wait_for_function(ANSWERED, timeout=60_000)
                page.wait_for_timeout(500)
                to = folder / f"{name.replace('/', '-')}-{screen}-{colour}.png"
                page.screenshot(path=to, full_page=screen == "phone")
                sys.stdout.write(f"{to}: {page.inner_text('#summary')}\n")
            page.close()
    if errors:
        raise SystemExit(f"the page: {errors[0]}")


def bundles(page: Page) -> list[str]:
    """Return the names of the bundles, once the first has answered."""
    page.wait_for_function(ANSWERED, timeout=60_000)
    return page.eval_on_selector_all("#bundle option", "each => each.map(o => o.value)")


if __name__ == "__main__":
    if len(sys.argv) != 3:
        raise SystemExit(__doc__)
    main(sys.argv[1], Path(sys.argv[2]))
