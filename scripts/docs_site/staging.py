"""The documents as Sphinx takes them: one folder, a table of contents, and links that stay within."""

from __future__ import annotations

import json
import os
import re
import shutil
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
DOCS = ROOT / "docs"
# Files of the project's folder that are pages of the site too
BESIDE = ("CONTRIBUTING.md", "CHANGELOG.md")
# The parts of the site, and their pages in order; a pattern takes those that are not named
PARTS = {
    "The manual": (
        "manual/README.md",
        "manual/install.md",
        "manual/first-render.md",
        "manual/noise-and-speed.md",
        "manual/from-cycles.md",
        "manual/supported.md",
        "manual/gpu.md",
        "manual/memory.md",
        "manual/disk.md",
        "manual/troubleshooting.md",
        "manual/beyond-memory.md",
        "manual/panels/README.md",
    ),
    "Panels": ("manual/panels/*.md",),
    "In depth": (
        "viewport.md",
        "before-the-render.md",
        "denoising.md",
        "passes.md",
        "light-linking.md",
        "checkpoints.md",
        "devices.md",
        "cluster.md",
        "convergence-in-blender.md",
        "headless.md",
        "command-line.md",
        "nodes.md",
        "tuning.md",
    ),
    "For researchers": (
        "architecture.md",
        "batching.md",
        "streaming.md",
        "large-scenes.md",
        "textures-beyond-memory.md",
        "statistics.md",
        "library.md",
        "laboratory.md",
        "convergence.md",
        "ray-traces.md",
        "studies/README.md",
        "studies/own.md",
        "studies/*.md",
        "experiments/*.md",
    ),
    "What was measured": ("parity.md", "real-files.md", "stability.md", "testing.md"),
    "The project": BESIDE,
}
FIRST, FIRST_OF_SITE = "README.md", "index.md"
NOTEBOOK = ".ipynb"  # how notebooks end, which are pages too
_LINK = re.compile(r"(!?)\[((?:[^\[\]]|\[[^\]]*\])*)\]\(([^)\s]+)\)")
_CODE = re.compile(r"^(?:```|~~~).*?^(?:```|~~~)[ \t]*$", re.MULTILINE | re.DOTALL)


def pages_of(parts: dict[str, tuple[str, ...]], there: set[str]) -> dict[str, list[str]]:
    """The pages of each part, of those that are `there`; raises `ValueError` where one is missing or in no part."""
    left = set(there)
    found: dict[str, list[str]] = {}
    named = {page for patterns in parts.values() for page in patterns}
    for part, patterns in parts.items():
        found[part] = []
        for pattern in patterns:
            pages = sorted(
                page for page in left if Path(page).match(pattern) and (page == pattern or page not in named)
            )
            if not pages:
                raise ValueError(f"{part}: there is no page {pattern}")
            found[part] += pages
            left -= set(pages)
    if left:
        raise ValueError(f"in no part of the site: {', '.join(sorted(left))}; name it in {Path(__file__).name}")
    return found


def contents(parts: dict[str, list[str]]) -> str:
    """The tables of contents, which the first page holds unseen."""
    lines = []
    for part, pages in parts.items():
        lines += ["", "```{toctree}", ":hidden:", f":caption: {part}", "", *pages, "```"]
    return "\n".join(lines) + "\n"


def with_links_within(text: str, page: Path, original: Path) -> str:
    """`text` of the file `original`, as it reads where it is the page `page` of the site.

    Paths of both are relative to the project's folder and to the site. A link to what the site does not have, as a
    folder or a source, becomes plain text.
    """

    def rewritten(found: re.Match) -> str:
        mark, label, target = found.groups()
        if re.match(r"[a-z]+:", target) or target.startswith("#"):
            return found[0]
        path, hash_mark, anchor = target.partition("#")
        meant = os.path.normpath(original.parent / path)
        site = meant.removeprefix(f"docs{os.sep}") if meant.startswith(f"docs{os.sep}") else meant
        if (ROOT / meant).is_dir() or (site == meant and meant not in BESIDE):
            return found[0] if mark else label
        if site.endswith(NOTEBOOK):
            site = site.removesuffix(NOTEBOOK) + ".md"
        site = FIRST_OF_SITE if meant == os.path.join("docs", FIRST) else site
        return f"{mark}[{label}]({Path(os.path.relpath(site, page.parent)).as_posix()}{hash_mark}{anchor})"

    parts, end = [], 0
    for code in _CODE.finditer(text):
        parts += [_LINK.sub(rewritten, text[end : code.start()]), code[0]]
        end = code.end()
    return "".join([*parts, _LINK.sub(rewritten, text[end:])])


def text_of(path: Path) -> str:
    """A page in Markdown; of a notebook its texts, and its code as blocks."""
    text = path.read_text(encoding="utf-8")
    if path.suffix != NOTEBOOK:
        return text
    cells = [(cell["cell_type"], "".join(cell["source"])) for cell in json.loads(text)["cells"]]
    return "\n\n".join(source if kind == "markdown" else f"```python\n{source}\n```" for kind, source in cells) + "\n"


def stage(folder: Path) -> None:
    """Lay the site's sources out in `folder`, which is made anew."""
    shutil.rmtree(folder, ignore_errors=True)
    shutil.copytree(DOCS, folder)
    pages = [*DOCS.rglob("*.md"), *DOCS.rglob(f"*{NOTEBOOK}")]
    sources = {path.relative_to(DOCS).with_suffix(".md").as_posix(): path for path in pages}
    sources |= {name: ROOT / name for name in BESIDE}
    parts = pages_of(PARTS, set(sources) - {FIRST})
    for name, path in sources.items():
        text = with_links_within(text_of(path), Path(name), path.relative_to(ROOT))
        (folder / name).write_text(text + (contents(parts) if name == FIRST else ""), encoding="utf-8")
    (folder / FIRST).rename(folder / FIRST_OF_SITE)
