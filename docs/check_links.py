"""Look for broken links in a built site, without a network: `python docs/check_links.py docs/_build/html`.

Every link must lead to a file and an anchor that exist, every picture must be there, and no page may load anything from
elsewhere.
"""

from __future__ import annotations

import sys
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote, urlsplit

LOADED = {("img", "src"), ("script", "src"), ("link", "href"), ("source", "src"), ("iframe", "src")}


class Page(HTMLParser):
    """Anchors of a page, and what it refers to."""

    def __init__(self, path: Path) -> None:
        super().__init__()
        self.anchors: set[str] = set()
        self.links: list[tuple[str, str, str]] = []
        self.feed(path.read_text(encoding="utf-8"))

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        """Take note of one element."""
        for name, value in attrs:
            if value and (name == "id" or (name == "name" and tag == "a")):
                self.anchors.add(value)
            if value is not None and name in ("href", "src"):
                self.links.append((tag, name, value))


def complaints(site: Path) -> list[str]:
    """Return a line for each link of a site that leads nowhere, or loads from elsewhere."""
    pages = {path.resolve(): Page(path) for path in sorted(site.rglob("*.html"))}
    found = [] if pages else [f"{site}: no pages"]
    for path, page in pages.items():
        for tag, name, link in page.links:
            parts = urlsplit(link)
            fault = None
            if parts.scheme or parts.netloc:
                fault = "is loaded from elsewhere" if (tag, name) in LOADED and parts.scheme != "data" else None
            else:
                target = (path.parent / unquote(parts.path)).resolve() if parts.path else path
                anchor = unquote(parts.fragment)
                if not target.is_file():
                    fault = "is not there"
                elif anchor and target in pages and anchor not in pages[target].anchors:
                    fault = "has no such anchor"
            if fault:
                found.append(f"{path.relative_to(site.resolve())}: {link} {fault}")
    return found


if __name__ == "__main__":
    faults = complaints(Path(sys.argv[1]))
    print("\n".join(faults) or "every link leads somewhere")
    sys.exit(bool(faults))
