"""What other commands left to look at: their pictures and what they wrote beside them."""

from dataclasses import dataclass
from pathlib import Path

from markdown_it import MarkdownIt
from markupsafe import Markup

MOST_BYTES = 20_000_000
"""A larger file is named and left out."""
PNG = b"\x89PNG\r\n\x1a\n"


@dataclass(frozen=True)
class Extra:
    anchor: str
    title: str
    command: str
    """What makes it."""
    pictures: tuple[tuple[str, bytes], ...] = ()
    """Name and PNG."""
    texts: tuple[tuple[str, Markup], ...] = ()
    """Name and HTML."""
    problems: tuple[str, ...] = ()


def read_extra(anchor: str, title: str, command: str, folder: Path | None) -> Extra:
    """The pictures (*.png) and reports (*.md) in a folder; empty where there are none. Nothing is raised."""
    pictures, texts, problems = [], [], []
    for file in sorted(folder.glob("*")) if folder is not None else ():
        if file.suffix not in (".png", ".md") or not file.is_file():
            continue
        try:
            if file.stat().st_size > MOST_BYTES:
                problems.append(f"{file.name} has more than {MOST_BYTES // 10**6} MB and is left out")
            elif file.suffix == ".md":
                texts.append((file.name, to_html(file.read_text(encoding="utf-8", errors="replace"))))
            elif (content := file.read_bytes()).startswith(PNG):
                pictures.append((file.name, content))
            else:
                problems.append(f"{file.name} is no PNG and is left out")
        except OSError as error:
            problems.append(f"{file.name} cannot be read: {error.strerror}")
    return Extra(anchor, title, command, tuple(pictures), tuple(texts), tuple(problems))


def to_html(markdown: str) -> Markup:
    """Headings, paragraphs, lists and tables; HTML in it stays text, pictures and links are left out."""
    reader = MarkdownIt("commonmark", {"html": False}).enable("table").disable(["image", "link", "autolink"])
    return Markup(reader.render(markdown))  # escaped by the reader
