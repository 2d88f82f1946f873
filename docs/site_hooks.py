"""What the site needs besides mkdocs.yml: pages from the repository's root, links, examples."""

import re
from pathlib import Path
from typing import Any

import griffe
from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files
from mkdocs.structure.pages import Page

PAGES = {
    "README.md": "index.md",
    "CONTRIBUTING.md": "contributing.md",
    "CHANGELOG.md": "changelog.md",
    "LICENSE": "licence.md",
    "CITATION.cff": "CITATION.cff",
}
LINK = re.compile(r"(?<=\]\()(docs/)?([^)#:]+)")  # in Markdown, not to another site
NOTEBOOK_LINK = re.compile(r'(?<=href=")([\w-]+\.md)(?=[#"])')
EXAMPLE = re.compile(r"^>>> .*(?:\n.+)*", re.MULTILINE)  # up to an empty line


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Add the pages, before MkDocs looks at its files.

    Their links are turned: at the root one is `docs/tracking.md` or `CHANGELOG.md`, in the site
    `tracking.md` or `changelog.md`.
    """
    root = Path(config.docs_dir).parent
    for name, page in PAGES.items():
        text = (root / name).read_text(encoding="utf-8")
        text = LINK.sub(lambda link: PAGES.get(link[2], link[2]), text)
        files.append(File.generated(config, page, content=text))
    return files


def on_page_content(html: str, *, page: Page, files: Files, **_: Any) -> str:
    """Turn the links of a notebook to other pages, which MkDocs does not look at."""
    if not page.file.src_uri.endswith(".ipynb"):
        return html
    return NOTEBOOK_LINK.sub(
        lambda link: files.src_uris[link[1]].url_relative_to(page.file.url), html
    )


class Examples(griffe.Extension):
    """Shows examples in docstrings as code: to Markdown, `>>>` would be a quotation."""

    def on_object(self, *, obj: griffe.Object, **_: Any) -> None:
        """Put a fence around the examples of one object."""
        if obj.docstring:
            obj.docstring.value = EXAMPLE.sub(r"```pycon\n\g<0>\n```", obj.docstring.value)
