"""The link checker of the documentation sees what is broken."""

from __future__ import annotations

import runpy

import pytest
from scripts import ROOT, run

complaints = runpy.run_path(str(ROOT / "docs" / "check_links.py"))["complaints"]


@pytest.mark.parametrize(
    "element, complaint",
    [
        ('<a href="other.html">to a page</a>', None),
        ('<a href="other.html#here">to an anchor</a>', None),
        ('<a href="#top">up</a>', None),
        ('<a href="">here</a>', None),
        ('<a href="folder/a%20name.txt">to a file</a>', None),
        ('<a href="https://example.org/nothing">elsewhere</a>', None),
        ('<a href="mailto:nobody">letter</a>', None),
        ('<img src="data:image/png;base64,AAAA">', None),
        ('<a href="missing.html">x</a>', "missing.html is not there"),
        ('<a href="folder">x</a>', "folder is not there"),
        ('<a href="other.html#nowhere">x</a>', "other.html#nowhere has no such anchor"),
        ('<a href="#nowhere">x</a>', "#nowhere has no such anchor"),
        ('<img src="missing.png">', "missing.png is not there"),
        ('<script src="https://example.org/x.js"></script>', "https://example.org/x.js is loaded from elsewhere"),
        ('<link href="//example.org/x.css">', "//example.org/x.css is loaded from elsewhere"),
    ],
)
def test_links_lead_somewhere_or_are_told(tmp_path, element, complaint):
    (tmp_path / "folder").mkdir()
    (tmp_path / "folder" / "a name.txt").write_text("text", encoding="utf-8")
    (tmp_path / "other.html").write_text('<h1 id="here">Other</h1>', encoding="utf-8")
    (tmp_path / "index.html").write_text(f'<h1 id="top">Title</h1>{element}', encoding="utf-8")
    assert complaints(tmp_path) == ([f"index.html: {complaint}"] if complaint else [])


def test_as_a_command_it_fails_on_a_fault_and_on_an_empty_site(tmp_path):
    script = str(ROOT / "docs" / "check_links.py")
    assert run(tmp_path, script, str(tmp_path)).returncode == 1
    (tmp_path / "index.html").write_text('<a href="gone.html">x</a>', encoding="utf-8")
    done = run(tmp_path, script, str(tmp_path))
    assert done.returncode == 1 and "gone.html" in done.stdout
    (tmp_path / "gone.html").write_text("back", encoding="utf-8")
    assert run(tmp_path, script, str(tmp_path)).returncode == 0
