"""The page as a person sees it: in a real browser, on a phone and on a desk, in light and dark."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from baselines.experiment import Entry
from baselines.records import RunFiles, open_log
from baselines.report import write_report
from baselines.study import open_study
from tests.baselines.fakes import experiment, install, record

CHROMIUM = shutil.which("chromium") or shutil.which("google-chrome")
PHONE, DESK = {"width": 390, "height": 844}, {"width": 1280, "height": 800}

pytestmark = pytest.mark.skipif(CHROMIUM is None, reason="Chromium is not installed")


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    from playwright.sync_api import sync_playwright

    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=CHROMIUM, args=["--no-sandbox"])
        yield browser
        browser.close()


@pytest.fixture
def report(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    install(monkeypatch)
    entries = [Entry(name, "fake", {}) for name in ("fake", "better", "a-name-that-is-long")]
    open_study(tmp_path, experiment(*entries, seeds=3), "bnprl compare X")
    for rank, entry in enumerate(entries):
        for seed in range(3):
            with open_log(RunFiles(tmp_path, entry.name, seed).records) as log:
                early = {"episodes": 50, "steps": 200, "train_seconds": 0.5, "return_mean": -0.1}
                log.append(record(contender=entry.name, seed=seed, final=False, **early))
                value = 0.1 * seed + (0.2, 0.7, -0.3)[rank]
                log.append(record(contender=entry.name, seed=seed, return_mean=value))
    write_report(tmp_path)
    return tmp_path / "report.html"


@pytest.fixture(params=[(PHONE, "dark"), (DESK, "light")], ids=["phone, dark", "desk, light"])
def page(browser: Any, report: Path, request: pytest.FixtureRequest) -> Iterator[Any]:
    size, scheme = request.param
    context = browser.new_context(viewport=size, color_scheme=scheme, offline=True)
    page = context.new_page()
    complaints: list[str] = []
    requests: list[str] = []
    page.on("console", lambda message: complaints.append(message.text))
    page.on("pageerror", lambda error: complaints.append(str(error)))
    page.on("request", lambda r: requests.append(r.url.partition(":")[0]))
    page.goto(report.as_uri())
    yield page
    context.close()
    assert complaints == []
    assert set(requests) <= {"file", "data"}


def column(page: Any, index: int) -> list[str]:
    cells = page.locator(f"#results tbody tr:not(.reference) td:nth-child({index})")
    return [str(text) for text in cells.all_inner_texts()]


def test_tables_sort_by_what_is_clicked(page: Any) -> None:
    mean = page.get_by_role("button", name="mean", exact=True)
    mean.click()
    assert column(page, 1) == ["better", "fake", "a-name-that-is-long"]
    mean.press("Enter")  # and by the keyboard
    assert column(page, 1) == ["a-name-that-is-long", "fake", "better"]
    assert column(page, 2)[0].startswith("−")
    page.get_by_role("button", name="agent").click()
    assert column(page, 1) == sorted(column(page, 1), reverse=True)


def test_curves_show_and_nothing_is_wider_than_the_screen(page: Any) -> None:
    assert page.locator("img").evaluate("image => image.naturalWidth") > 500
    assert page.evaluate("document.documentElement.scrollWidth <= window.innerWidth")
    dark = page.evaluate("matchMedia('(prefers-color-scheme: dark)').matches")
    ground = page.evaluate("getComputedStyle(document.body).backgroundColor")
    assert ground == ("rgb(22, 24, 28)" if dark else "rgb(255, 255, 255)")
    light, other = (
        page.locator("img").get_attribute("src"),
        page.locator("img").evaluate("i => i.currentSrc"),
    )
    assert (light != other) == dark


def test_pairs_open_on_demand(page: Any) -> None:
    table = page.locator("#pairs")
    assert not table.is_visible()
    page.get_by_text("Head to head").click()
    assert table.is_visible()
    assert page.locator("#pairs tbody tr").count() == 3
