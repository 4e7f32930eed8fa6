"""The site of the documents: what it is made of, what its check finds, and the whole of it where its tools are."""

import importlib.util
from pathlib import Path

import pytest
from docs_site import build as make_docs
from docs_site import staging
from docs_site.checking import faults
from docs_site.staging import PARTS, contents, pages_of, stage, with_links_within

from tests.support.command_line import ROOT, run_script


def links(text, page, original):
    return with_links_within(text, Path(page), Path(original))


def test_links_lead_to_pages_of_the_site():
    assert links("[a](docs/tuning.md#presets)", "CONTRIBUTING.md", "CONTRIBUTING.md") == "[a](tuning.md#presets)"
    assert links("[a](../CONTRIBUTING.md)", "tuning.md", "docs/tuning.md") == "[a](CONTRIBUTING.md)"
    assert links("[a](../../CHANGELOG.md)", "manual/disk.md", "docs/manual/disk.md") == "[a](../CHANGELOG.md)"
    assert links("[a](../README.md)", "manual/disk.md", "docs/manual/disk.md") == "[a](../index.md)"
    assert links("![a](images/x.png)", "tuning.md", "docs/tuning.md") == "![a](images/x.png)"


def test_links_to_what_the_site_has_not_are_plain_text():
    assert links("see [the data](data).", "studies/README.md", "docs/studies/README.md") == "see the data."
    assert links("[a](../README.md#x)", "tuning.md", "docs/tuning.md") == "a"
    assert links("[a](https://b.c/d) [e](#f)", "tuning.md", "docs/tuning.md") == "[a](https://b.c/d) [e](#f)"
    code = "```\n[a](data)\n```\n"
    assert links(code, "studies/README.md", "docs/studies/README.md") == code


def test_every_page_has_its_place():
    there = {"a.md", "m/b.md", "m/c.md"}
    assert pages_of({"A": ("a.md",), "M": ("m/c.md", "m/*.md")}, there) == {"A": ["a.md"], "M": ["m/c.md", "m/b.md"]}
    with pytest.raises(ValueError, match=r"in no part of the site: m/c\.md"):
        pages_of({"A": ("a.md", "m/b.md")}, there)
    with pytest.raises(ValueError, match=r"there is no page d\.md"):
        pages_of({"A": ("d.md",)}, there)


def test_the_documents_are_staged(tmp_path):
    stage(tmp_path / "source")
    text = (tmp_path / "source/index.md").read_text(encoding="utf-8")
    pages = [line for line in text.splitlines() if line.endswith(".md") and " " not in line]
    staged = {path.relative_to(tmp_path / "source").as_posix() for path in (tmp_path / "source").rglob("*.md")}
    assert set(pages) == staged - {"index.md"} and len(pages) == len(set(pages))
    assert all(f":caption: {part}" in text for part in PARTS)
    assert contents({"A": ["a.md"]}) in "\n```{toctree}\n:hidden:\n:caption: A\n\na.md\n```\n"


@pytest.mark.parametrize(
    "body, fault",
    [
        ('<a href="b.html#there">b</a><img src="p.png">', ""),
        ('<a href="https://example.org">elsewhere</a>', ""),
        ('<a href="c.html">c</a>', "a.html links c.html, which is not there"),
        ('<a href="b.html#gone">b</a>', "a.html links b.html#gone, and the page has no such heading"),
        ('<img src="q.png">', "a.html links q.png, which is not there"),
        ('<script src="https://cdn.example.org/x.js"></script>', "a.html fetches https://cdn.example.org/x.js"),
        ('<link rel="stylesheet" href="//fonts.example.org/f.css">', "a.html fetches //fonts.example.org/f.css"),
    ],
)
def test_what_leads_nowhere_or_to_the_network_is_found(body, fault, tmp_path):
    (tmp_path / "a.html").write_text(body, encoding="utf-8")
    (tmp_path / "b.html").write_text('<h1 id="there">b</h1>', encoding="utf-8")
    (tmp_path / "p.png").write_bytes(b"")
    assert faults(tmp_path) == ([fault] if fault else [])


def test_styles_that_fetch_and_sites_without_pages_are_found(tmp_path):
    assert faults(tmp_path) == [f"{tmp_path} has no pages"]
    (tmp_path / "a.html").write_text("<p>a</p>", encoding="utf-8")
    (tmp_path / "a.css").write_text('@font-face { src: url("https://example.org/f.woff") }', encoding="utf-8")
    assert faults(tmp_path) == ["a.css fetches from the network"]


def test_tools_are_pinned_and_not_those_of_the_environment():
    wanted = make_docs.wanted()
    assert wanted and all("==" in each for each in wanted)
    assert make_docs.missing(["pytest==0.0.1", "no-such-tool==1"]) == ["pytest==0.0.1", "no-such-tool==1"]
    assert not [
        each for each in wanted if each in (ROOT / "scripts/environment/environment.py").read_text(encoding="utf-8")
    ]


@pytest.mark.skipif(importlib.util.find_spec("sphinx") is None, reason="`make docs` was not run here")
def test_a_broken_link_fails_the_build(tmp_path, monkeypatch):
    sources = tmp_path / "source"
    stage(sources)
    for path in [*sources.rglob("*.md")]:
        if path.name not in ("index.md", "headless.md"):
            path.unlink()
    (sources / "index.md").write_text("# A\n\n[b](gone.md)\n\n```{toctree}\nheadless.md\n```\n", encoding="utf-8")
    (sources / "headless.md").write_text("# B\n", encoding="utf-8")
    assert make_docs.build(sources, tmp_path / "site") != 0
    (sources / "index.md").write_text("# A\n\n```{toctree}\nheadless.md\n```\n", encoding="utf-8")
    assert make_docs.build(sources, tmp_path / "site") == 0
    assert faults(tmp_path / "site") == []


def test_a_page_in_no_part_is_reported(tmp_path, monkeypatch):
    monkeypatch.setattr(staging, "PARTS", {"The project": ("CHANGELOG.md",)})
    with pytest.raises(ValueError, match="in no part of the site"):
        stage(tmp_path / "source")
    assert run_script("docs_site/build.py", "--help").returncode == 0
