"""Whether a built site is whole: links and pictures lead to what is there, and nothing comes from the network."""

from __future__ import annotations

from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote, urlsplit

# What a browser fetches by itself: attribute, by element
_FETCHED = {"img": "src", "script": "src", "source": "src", "iframe": "src", "video": "src", "audio": "src"}
_LINK_KINDS = {"stylesheet", "icon", "preload", "prefetch", "modulepreload", "manifest"}


class _Page(HTMLParser):
    """A page's links, the files that it fetches, and its anchors."""

    def __init__(self, text: str):
        super().__init__()
        self.linked: list[str] = []
        self.fetched: list[str] = []
        self.anchors: set[str] = set()
        self.feed(text)

    def handle_starttag(self, tag: str, attributes: list[tuple[str, str | None]]) -> None:
        values = {name: value or "" for name, value in attributes}
        self.anchors |= {values[name] for name in ("id", "name") if values.get(name)}
        if tag == "a" and "href" in values:
            self.linked.append(values["href"])
        if values.get(_FETCHED.get(tag, "")):
            self.fetched.append(values[_FETCHED[tag]])
        if tag == "link" and values.get("href") and _LINK_KINDS & set(values.get("rel", "").split()):
            self.fetched.append(values["href"])


def faults(site: Path) -> list[str]:
    """A line for each link or picture that leads nowhere, and for each thing that comes from the network."""
    site = site.resolve()
    pages = {path: _Page(path.read_text(encoding="utf-8")) for path in sorted(site.rglob("*.html"))}
    found = [] if pages else [f"{site} has no pages"]
    for path, page in pages.items():
        name = path.relative_to(site).as_posix()
        for target in page.fetched:
            if urlsplit(target).netloc:
                found.append(f"{name} fetches {target}")
        for target in dict.fromkeys(page.linked + page.fetched):
            parts = urlsplit(target)
            if parts.scheme or parts.netloc:
                continue
            meant = (path.parent / unquote(parts.path)).resolve() if parts.path else path
            if not meant.is_file():
                found.append(f"{name} links {target}, which is not there")
            elif parts.fragment and meant in pages and unquote(parts.fragment) not in pages[meant].anchors:
                found.append(f"{name} links {target}, and the page has no such heading")
    for style in sorted(site.rglob("*.css")):
        text = style.read_text(encoding="utf-8", errors="replace")
        if any(mark in text for mark in ("url(http", "url(//", 'url("http', "url('http", "@import")):
            found.append(f"{style.relative_to(site).as_posix()} fetches from the network")
    return found
