"""The page of a fit: whole, alone, and the same each time."""

from __future__ import annotations

import html
import re
import shutil
import subprocess
import sys
from datetime import date
from html.parser import HTMLParser

import control as ct
import numpy as np
import pytest
from shell import without_pictures

import ph_control as phc


class Page(HTMLParser):
    """Tags of a page, those that are open, and where its pictures come from."""

    def __init__(self, text):
        super().__init__()
        self.open, self.tags, self.sources, self.headings = [], [], [], []
        self.links, self.places = [], []
        self.feed(text)

    def handle_starttag(self, tag, attrs):
        self.tags.append(tag)
        if tag not in ("meta", "img", "br"):
            self.open.append(tag)
        self.sources += [value for name, value in attrs if name == "src"]
        self.links += [value for name, value in attrs if name == "href"]
        self.places += [f"#{value}" for name, value in attrs if name == "id"]

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        if self.open and self.open[-1] in ("h1", "h2", "h3"):
            self.headings.append(data)


@pytest.fixture(scope="module")
def structure():
    rng = np.random.default_rng(0)
    plant = phc.spring_chain([1.0, 1.0], 2.0, ground=[1.0, 0.0], c=0.02, ground_c=0.01, port=[0, 1])
    u = rng.standard_normal((2, 1200))
    y = phc.forced_response(plant, 0.2 * np.arange(1200), u, intersample="zoh").outputs
    y = y + 0.05 * rng.standard_normal(y.shape)
    data = ct.TimeResponseData(
        0.2 * np.arange(1200), y, inputs=u, issiso=False, input_labels=["shaker 1", "shaker <2>"],
        output_labels=["top", "base & foot"],
    )  # fmt: skip
    return phc.pem(data, 2, ports=[(0, 0), (1, 1)])


@pytest.mark.slow
def test_page_stands_alone_with_all_its_parts(structure, tmp_path):
    structure.report(tmp_path / "fit.html", title="Tower <1>")
    text = (tmp_path / "fit.html").read_text(encoding="utf-8")
    page = Page(text)
    assert not page.open and "script" not in page.tags and "link" not in page.tags
    assert page.links == page.places and "#summary" in page.links
    assert date.today().isoformat() in text and "@media print" in text
    assert page.sources and all(one.startswith("data:image/svg+xml;base64,") for one in page.sources)
    for heading in ("Tower <1>", "Tests of structure", "Measured and predicted", "Frequency responses", "Mode shapes",
                    "Modal assurance", "Stabilisation", "Residuals", "To repeat it"):  # fmt: skip
        assert heading in page.headings
    assert "shaker &lt;2&gt;" in text and "base &amp; foot" in text
    assert all(f"<td>{number:.9f}"[:8] in text for number in structure.hertz)
    assert re.search(r"numpy \d+\.\d+", text)
    call = re.search(r"phc\.pem\(data, (order=2, .*)\)", html.unescape(text))
    record = structure.experiments[0].record
    again = phc.pem((record.u, record.y), dt=record.dt, **eval(f"dict({call[1]})"))
    np.testing.assert_allclose(again.poles, structure.poles, rtol=1e-5)
    structure.report(tmp_path / "again.html", title="Tower <1>")
    assert (tmp_path / "again.html").read_text(encoding="utf-8") == text


@pytest.mark.slow
@pytest.mark.variants
@pytest.mark.parametrize("options", [{"initial_state": "zero", "offset": True}, {"offset": False}])
def test_the_call_on_the_page_repeats_initial_state_and_offset(options, tmp_path):
    rng, plant = np.random.default_rng(3), phc.ph(phc.modes([1.0, 2.5], [1.0, 0.4], damping=0.02))
    t, u = 0.1 * np.arange(800), rng.standard_normal(800)
    y = phc.forced_response(plant, t, u, intersample="zoh").outputs + 0.1 * rng.standard_normal(800) + 0.2
    data = ct.TimeResponseData(t, y, inputs=u, issiso=True, title="mast.csv")
    result = phc.pem(data, 2, **options)
    result.report(tmp_path / "fit.html")
    text = html.unescape((tmp_path / "fit.html").read_text(encoding="utf-8"))
    call = re.search(r"phc\.pem\(data, (order=2, .*)\)", text)
    again = phc.pem(data, **eval(f"dict({call[1]})"))
    assert np.array_equal(again.offsets != 0, result.offsets != 0) and again.unknowns == result.unknowns
    np.testing.assert_allclose(again.poles, result.poles, rtol=1e-6)
    assert "mast.csv" in text


@pytest.mark.slow
def test_page_of_a_lossless_fit_and_files_that_are_there(tmp_path):
    rng = np.random.default_rng(1)
    plant, u = phc.ph(phc.modes([1.0, 2.5], [1.0, 0.4])), rng.standard_normal(600)
    y = phc.forced_response(plant, 0.1 * np.arange(600), u, intersample="zoh").outputs
    result = phc.pem((u, y + 0.1 * rng.standard_normal(600)), dt=0.1)
    path = tmp_path / "fit.html"
    result.report(path)
    page = Page(path.read_text(encoding="utf-8"))
    assert "Mode shapes" not in page.headings and "Stabilisation" in page.headings and not page.open
    with pytest.raises(phc.OutputExistsError, match="exists already"):
        result.report(path)
    result.report(path, overwrite=True)
    with pytest.raises(phc.FileMissingError):
        result.report(tmp_path / "none" / "fit.html")


def test_page_tells_experiments_apart_and_says_why_there_is_no_picture(tmp_path, monkeypatch):
    without_pictures(monkeypatch)
    rng, plant = np.random.default_rng(1), phc.ph(phc.modes([1.0, 2.5], [1.0, 0.4]))
    inputs = [rng.standard_normal(400) for _ in range(2)]
    steps = [0.1, 0.15]
    records = []
    for u, h in zip(inputs, steps, strict=True):
        y = phc.forced_response(plant, h * np.arange(400), u, intersample="zoh").outputs
        records.append((u, y + 0.1 * rng.standard_normal(400)))
    phc.pem(records, 2, dt=steps).report(tmp_path / "fit.html")
    text = (tmp_path / "fit.html").read_text(encoding="utf-8")
    assert "Experiment 1. The data" in text and "Experiment 2. The data" in text
    assert "No picture: the records have steps" in text


def test_page_of_a_response_shows_it_once(tmp_path, monkeypatch):
    without_pictures(monkeypatch)
    omega = np.linspace(0.3, 3.0, 200)
    plant, rng = phc.spring_chain([1.0], [], ground=1.0, ground_c=0.05), np.random.default_rng(0)
    noise = 0.01 * (rng.standard_normal(200) + 1j * rng.standard_normal(200))
    result = phc.pem(ct.frd(plant(1j * omega) + noise, omega), 1, structure="passive", ports=[(0, 0)])
    result.report(tmp_path / "fit.html")
    headings = Page((tmp_path / "fit.html").read_text(encoding="utf-8")).headings
    assert "Frequency responses" in headings and "Measured and predicted" not in headings


@pytest.mark.slow
def test_command_line_writes_the_page(tmp_path):
    rng = np.random.default_rng(2)
    plant, u = phc.ph(phc.modes(1.0, 1.0)), rng.standard_normal(400)
    y = phc.forced_response(plant, 0.1 * np.arange(400), u, intersample="zoh").outputs
    rows = np.column_stack([0.1 * np.arange(400), u, y + 0.1 * rng.standard_normal(400)])
    np.savetxt(tmp_path / "tower.csv", rows, delimiter=",", header="t,u,y", comments="")
    command = [sys.executable, "-m", "ph_control", "fit", "tower.csv", "--report", "fit.html"]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=True)
    assert "Written: fit.html" in done.stdout
    assert Page((tmp_path / "fit.html").read_text(encoding="utf-8")).headings[0] == "Identification report: tower"


@pytest.mark.slow
@pytest.mark.skipif(shutil.which("chromium") is None, reason="chromium is not installed")
def test_page_opens_in_a_browser(structure, tmp_path):
    structure.report(tmp_path / "fit.html", title="Tower")
    command = [
        "chromium", "--headless", "--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run",
        "--disable-background-networking", "--disable-component-update", "--disable-sync",
        f"--user-data-dir={tmp_path / 'profile'}", "--window-size=1280,4000", f"--screenshot={tmp_path / 'page.png'}",
        (tmp_path / "fit.html").as_uri(),
    ]  # fmt: skip
    subprocess.run(command, capture_output=True, check=True, timeout=120)
    assert (tmp_path / "page.png").stat().st_size > 50_000
