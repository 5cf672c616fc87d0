"""What mkdocs is told beside `mkdocs.yml`: pages made from schemas, and files of the repository that pages link to."""

import re
from pathlib import Path
from typing import Any

import docs_ablations
import docs_config
import docs_record
from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files, InclusionLevel

GENERATED = {"ablations.md": docs_ablations.page, "config.md": docs_config.page, "record.md": docs_record.page}
ROOT = Path(__file__).parents[1]
OUTSIDE = re.compile(r"\]\(\.\./([^)#\s]+)")
"""A link of a page in docs/ to a file beside docs/."""
PICTURE = re.compile(r"!\[[^\]]*\]\(([^)\s]+)\)")


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Adds the generated pages, and whatever lies outside docs/ and is linked to, under the same path."""
    for name, page in GENERATED.items():
        files.append(File.generated(config, name, content=page()))
    linked = {path for page in ROOT.glob("docs/*.md") for path in OUTSIDE.findall(page.read_text())}
    for path in sorted(linked):
        pictures = PICTURE.findall((ROOT / path).read_text()) if path.endswith(".md") else []
        for wanted in (path, *(f"{Path(path).parent}/{picture}" for picture in pictures)):
            if not (ROOT / wanted).is_file():
                raise FileNotFoundError(f"docs/ links to {wanted}, which does not exist")
            beside = {"abs_src_path": str(ROOT / wanted), "inclusion": InclusionLevel.NOT_IN_NAV}
            files.append(File.generated(config, wanted, **beside))
    return files


def on_page_markdown(markdown: str, **_: Any) -> str:
    """Links that leave docs/ lead to the copies that `on_files` makes."""
    return OUTSIDE.sub(r"](\1", markdown)
