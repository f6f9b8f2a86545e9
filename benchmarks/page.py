"""Put what a run has found into a page of the manual, in place of what stands there."""

from __future__ import annotations

from pathlib import Path


def marks(name: str) -> tuple[str, str]:
    """Lines between which a page holds what a run has found."""
    return f"<!-- begin of {name} -->", f"<!-- end of {name} -->"


def write(page: Path, name: str, parts: list[str]) -> None:
    """Put the parts that are not empty between the marks of a page."""
    begin, end = marks(name)
    text = page.read_text(encoding="utf-8")
    if text.count(begin) != 1 or text.count(end) != 1 or text.index(begin) > text.index(end):
        raise SystemExit(f"{page} must have the lines {begin!r} and {end!r} once each, in this order")
    before, after = text.partition(begin)[0], text.partition(end)[2]
    page.write_text(before + "\n\n".join([begin, *filter(None, parts), end]) + after, encoding="utf-8")
