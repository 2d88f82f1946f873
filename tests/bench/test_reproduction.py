"""The paper from one command: what must be reached is, and the page shows it in a browser.

The flows are those of test_simulations_tracked; everything else is as small as it can be.
"""

import json
import re
import shutil
import subprocess
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import pytest

from bench.reproduce import STAGES
from bench.reproduction.folder import Given, Reproduction, run_stages
from bench.reproduction.settings import SMALL

pytest.importorskip("trackeval")
TINY = replace(
    SMALL,
    images=4,
    valid=4,
    tiny=replace(SMALL.tiny, iterations=0),
    sine_frames=40,
    shear_steps=15_000,
    degraded=False,
    alternatives=False,
    speed_frames=3,
    speed_frames_full=0,
)
BROWSERS = ("chromium", "chromium-browser", "google-chrome", "chrome")
# looks at the page once all of it is there, and leaves what it saw as the title
LOOK = """<script>addEventListener("load", () => {
  const images = [...document.images];
  document.title = JSON.stringify({
    images: images.length,
    broken: images.filter(one => !one.naturalWidth).map(one => one.src),
    wider: document.documentElement.scrollWidth > innerWidth,
    from_outside: performance.getEntriesByType("resource")
      .map(one => one.name).filter(name => !name.startsWith("file:")),
    headings: [...document.querySelectorAll("h2")].map(one => one.innerText),
    hidden: [...document.querySelectorAll("section")].filter(one => !one.offsetHeight).length,
  });
});</script>"""


@pytest.fixture(scope="session")
def reproduction(
    tmp_path_factory: pytest.TempPathFactory, four_cores: Path, nineteen_droplets: Path
) -> Path:
    """A reproduction from tiny inputs, with both simulations in place."""
    out = tmp_path_factory.mktemp("reproduction") / "out"
    of = Reproduction(out, TINY, Given())
    run_stages(of, STAGES[:1], print)
    for name, flow in (("shear", four_cores), ("constriction", nineteen_droplets)):
        shutil.copytree(flow, out / "simulations" / name)
    run_stages(of, STAGES, print)
    return out


def results(folder: Path) -> dict[str, Any]:
    found: dict[str, Any] = json.loads((folder / "results.json").read_text())
    return found


def test_what_must_be_reached_is_reached_at_the_small_scale(reproduction: Path) -> None:
    methods = results(reproduction)["stages"]["evaluation"]["methods"]
    shear, dense, sine = (methods[flow]["droptrack"] for flow in ("shear", "constriction", "sine"))
    assert (shear["n_droplets_found_in_every_frame"], shear["n_switches"]) == (4, 0)
    assert (dense["n_droplets_found_in_every_frame"], dense["n_switches"]) == (19, 0)
    assert (sine["n_droplets_found_in_every_frame"], sine["n_switches"]) == (12, 0)
    assert max(one["mse_y_px2"] for one in shear["droplets"]) < 1.59e-2
    assert max(one["mse_y_px2"] for one in sine["droplets"]) < 2e-5
    assert dense["hota"] > 0.98
    assert len(results(reproduction)["must_reach"]) == 7
    assert all(gate["reached"] for gate in results(reproduction)["must_reach"])


def test_the_page_has_every_figure_and_table_with_the_papers_number(reproduction: Path) -> None:
    compared = results(reproduction)["compared"]
    theirs = {one["paper"] for rows in compared.values() for one in rows}
    # of its figures 6, 11, 12, 13 and its table 1
    assert {"0.985", "0.99", "0.47", "2.44", "35", "0.25", "12", "49"} <= theirs
    assert any("0.0344, 0.018, 0.0312, 0.0159" in text for text in theirs)
    assert any("0.000141, 0.000152, 0.000155, 0.000145" in text for text in theirs)
    page = (reproduction / "index.html").read_text()
    for figure in (*range(6, 16), 1, 2):
        assert re.search(rf"Figures? (\d+ and )?{figure}\b", page), figure
    assert "Table 1" in page
    assert page.count('class="word"') == page.count("<code>") - 1 == len(compared)


def test_the_page_says_that_the_full_network_has_no_weights_here(reproduction: Path) -> None:
    ours = {one["what"]: one["ours"] for one in results(reproduction)["compared"]["networks"]}
    assert ours["mAP@0.50 of YOLOv3 on scene c"] == "not trained here"
    page = (reproduction / "index.html").read_text()
    assert "no mAP and no loss is shown for it" in page
    assert "make reproduce SCALE=paper trains it" in page


class Links(HTMLParser):
    """Where a page's links and images point to."""

    def __init__(self) -> None:
        super().__init__()
        self.targets: list[str] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.targets += [value for name, value in attrs if name in ("href", "src") and value]


def test_everything_the_page_links_to_is_beside_it(reproduction: Path) -> None:
    links = Links()
    page = (reproduction / "index.html").read_text()
    links.feed(page)
    inside = [one[1:] for one in links.targets if one.startswith("#")]
    assert all(f'id="{name}"' in page for name in inside)
    files = [one for one in links.targets if not one.startswith("#")]
    assert [one for one in files if not (reproduction / one).is_file()] == []
    drawn = {Path(one).with_suffix("") for one in files if one.endswith(".png")}
    assert len(drawn) >= 12
    for one in drawn:
        assert (reproduction / one).with_suffix(".pdf").read_bytes().startswith(b"%PDF")


@pytest.mark.parametrize("width", [1200, 420])
def test_a_browser_without_a_network_shows_the_page(
    reproduction: Path, tmp_path: Path, width: int
) -> None:
    browser = next(filter(None, map(shutil.which, BROWSERS)), None)
    if browser is None:
        pytest.skip("no Chromium here")
    page = reproduction / f"looked_at_{width}.html"
    page.write_text((reproduction / "index.html").read_text().replace("</body>", f"{LOOK}</body>"))
    shown = subprocess.run(
        [
            browser, "--headless", "--no-sandbox", "--disable-gpu", "--dump-dom",
            f"--user-data-dir={tmp_path}", f"--window-size={width},900",
            "--virtual-time-budget=20000", "--host-resolver-rules=MAP * ~NOTFOUND",
            page.as_uri(),
        ],
        capture_output=True, text=True, check=True, timeout=120,
    ).stdout  # fmt: skip
    page.unlink()
    title = re.search("<title>(.*?)</title>", shown, re.DOTALL)
    assert title is not None
    seen = json.loads(title[1])
    assert seen["broken"] == seen["from_outside"] == []
    assert seen["images"] >= 12
    assert seen["hidden"] == 0
    assert not seen["wider"]
    assert len(seen["headings"]) == len(results(reproduction)["compared"]) + 2


def test_run_again_it_does_nothing_again(reproduction: Path) -> None:
    before = {path: path.stat().st_mtime_ns for path in reproduction.rglob("*")}
    said: list[str] = []
    run_stages(Reproduction(reproduction, TINY, Given()), STAGES, said.append)
    assert said == [f"{stage.name}: is there" for stage in STAGES]
    assert {path: path.stat().st_mtime_ns for path in reproduction.rglob("*")} == before
