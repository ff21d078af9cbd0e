"""Check the built site: links, headings, images, notebooks, nothing from other servers.

python scripts/check_site.py docs/_build/html
"""

import re
import sys
from collections.abc import Iterator
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote, urlsplit

LOADED = {
    "img": "src",
    "script": "src",
    "iframe": "src",
    "source": "src",
    "link": "href",
}
"""What a browser loads by itself, by tag; links lead elsewhere, and may."""


class Page(HTMLParser):
    """Addresses, anchors and images of a page."""

    def __init__(self, path: Path) -> None:
        super().__init__()
        self.path = path
        self.anchors: set[str] = {""}
        self.links: list[str] = []
        self.loaded: list[str] = []
        self.nameless: list[str] = []
        self.feed(path.read_text(encoding="utf-8"))

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        """Collect what a tag says."""
        given = {name: value or "" for name, value in attrs}
        self.anchors.update(given[name] for name in ("id", "name") if name in given)
        if tag == "a" and "href" in given:
            self.links.append(given["href"])
        if tag in LOADED and given.get("rel") not in (
            "canonical",
            "author",
            "index",
            "search",
        ):
            self.loaded.append(given.get(LOADED[tag], ""))
        if tag == "img" and not given.get("alt"):
            self.nameless.append(given.get("src", "")[:60])


def offenders(site: Path) -> Iterator[str]:
    """Yield everything that is wrong with a site, one line each."""
    pages = {
        path.resolve(): Page(path)
        for path in sorted(site.rglob("*.html"))
        if "_static" not in path.parts
    }
    if not pages:
        yield f"{site}: no pages"
    for path, page in pages.items():
        name = path.relative_to(site.resolve())
        for address in page.loaded:
            if re.match(r"(https?:)?//", address):
                yield f"{name}: loads {address}"
        for image in page.nameless:
            yield f"{name}: image without alternative text: {image}"
        for address in [*page.links, *page.loaded]:
            parts = urlsplit(address)
            if parts.scheme or parts.netloc or (not address.strip("#")):
                continue
            target = (
                (path.parent / unquote(parts.path)).resolve() if parts.path else path
            )
            if not target.exists():
                yield f"{name}: no file {address}"
            elif (
                target in pages and unquote(parts.fragment) not in pages[target].anchors
            ):
                yield f"{name}: no heading {address}"
    for path in sorted((site / "_sources" / "notebooks").glob("*.md")):
        built = pages[(site / "notebooks" / f"{path.stem}.html").resolve()]
        if "cell_output" not in built.path.read_text(encoding="utf-8"):
            yield f"notebooks/{path.name}: was not executed"


def main() -> None:
    """Print the offenders; exit 1 if there are any."""
    found = list(offenders(Path(sys.argv[1])))
    print(
        "\n".join(found)
        or f"{sys.argv[1]}: all links, images and notebooks are in order"
    )
    sys.exit(bool(found))


if __name__ == "__main__":
    main()
