"""The whole comparison: files one after another, engines in turn, and reports anew after each file."""

from __future__ import annotations

import argparse
import hashlib
import json
import shlex
import sys
import time
from dataclasses import replace
from pathlib import Path
from typing import IO, Any

from lib.command import UsageError
from lib.output import json_text, write_text

from real_files.code import code_of, of_extension, what_changed
from real_files.judging import NAMES
from real_files.listing import RealFile, files_listed, files_named
from real_files.manual import write_manual
from real_files.page import html_page
from real_files.process import COLD, ProcessOutcome, run_process
from real_files.records import ENGINES, Record, Records
from real_files.rows import DIFFERS, FAILED, SAME, VARIANCE, row_of, summary_of
from real_files.tables import counted, notes_of_old, remarks, summary_rows
from real_files.worker import PICTURES, SOURCES


def compare(options: argparse.Namespace, root: Path, script: Path, standard_output: IO[str]) -> int:
    """The exit code; raises `UsageError`, and `OutputError` for a folder that cannot be written."""
    with of_extension(options.extension, script) as chosen:
        return _compare(options, root, chosen, standard_output)


def _compare(options: argparse.Namespace, root: Path, script: Path, standard_output: IO[str]) -> int:
    files = _files(options)
    kernel_cache = options.kernel_cache
    if kernel_cache not in (None, COLD):
        if not Path(kernel_cache).is_dir():
            raise UsageError(f"--kernel-cache {kernel_cache} is no folder: name one with kernels, or “{COLD}” for none")
        kernel_cache = str(Path(kernel_cache).absolute())
    records = Records(options.out.absolute())
    records.prepare()
    request = {
        "width": options.width,
        "samples": options.samples,
        "threads": options.threads,
        "repeats": options.repeats,
        "defaults": options.defaults,
        "kernel_cache": "the user's" if kernel_cache is None else COLD if kernel_cache == COLD else "a copy",
    }
    if options.kernels != "AUTO":  # else the request is that of comparisons before there was a choice
        request["kernels"] = options.kernels
    if options.extension:
        sum_of_all = hashlib.md5(options.extension.read_bytes(), usedforsecurity=False).hexdigest()
        request["extension"] = f"{options.extension.name} ({sum_of_all})"
    reporter = _Reporter(records, root, request if files else _kept_request(records.folder.parent), options.note)
    for number, file in enumerate(files):
        start = time.monotonic()
        record = _compared(file, records, request, options, script, kernel_cache)
        report = reporter.write()
        row = next(each for each in report["files"] if each["name"] == record.name)
        print(
            f"[{number + 1}/{len(files)}] {file.name}: {row['verdict']} ({time.monotonic() - start:.0f} s)",
            *(f"\n    {kind}: {text}" for kind, text in remarks(row) if kind in ("error", "superposition")),
            sep="",
            file=sys.stderr,
            flush=True,
        )
    report = reporter.write()
    if options.table:
        reporter.write_table(report)
    print(_text(report, records.folder.parent), file=standard_output)
    asked = {file.name for file in files}
    return int(any(row["verdict"] == FAILED or row["errors"] for row in report["files"] if row["name"] in asked))


def _files(options: argparse.Namespace) -> list[RealFile]:
    files = files_named(options.files)
    if options.list:
        if options.folder is None:
            raise UsageError("--list needs --folder, which says where its files are")
        files += files_listed(options.list, options.folder.absolute(), options.only)
    elif options.folder or options.only:
        raise UsageError("--folder and --only go with --list, which is not given: name the FILEs alone")
    if not files and not options.table:
        raise UsageError("name .blend FILEs, or a list of them with --list and --folder")
    return files


def _compared(
    file: RealFile,
    records: Records,
    request: dict[str, Any],
    options: argparse.Namespace,
    script: Path,
    kernel_cache: str | None,
) -> Record:
    """The record of `file`, with everything rendered that was missing; written after each process."""
    complaint = file.complaint()
    if complaint:
        record = Record(file.name, file.about, request, complaint=complaint)
        records.write(file, record)
        return record
    md5 = file.md5()
    record = Record(file.name, file.about, request, md5) if options.again else records.read(file, request, md5)
    for kind in (PICTURES, SOURCES):
        if kind == SOURCES and not _to_be_judged(record, options):
            break
        for engine in ENGINES:
            if record.is_old(engine, kind):
                changed = what_changed(record.code(engine, kind), code_of(engine))
                print(f"{file.name}: {kind} by {NAMES[engine]} are of {changed}: rendered again", file=sys.stderr)
            elif record.is_done(engine, kind):
                continue
            wanted = {"file": str(file.path), "engine": engine, "kind": kind, **request}
            outcome = run_process(script, wanted, options.limit, kernel_cache)
            record.take(engine, kind, _without_place(outcome, file, options.folder))
            records.write(file, record)
    return record


def _without_place(outcome: ProcessOutcome, file: RealFile, folder: Path | None) -> ProcessOutcome:
    """`outcome` with texts that do not say where the file lies on this machine: // is its folder, as in Blender."""

    def without_folders(value):
        if isinstance(value, str):
            value = value.replace(f"{file.path.parent}/", "//")
            return value.replace(f"{folder.absolute()}/", "FOLDER/") if folder else value
        if isinstance(value, list):
            return [without_folders(each) for each in value]
        return {name: without_folders(each) for name, each in value.items()} if isinstance(value, dict) else value

    return replace(outcome, error=without_folders(outcome.error), state=without_folders(outcome.state))


def _to_be_judged(record: Record, options: argparse.Namespace) -> bool:
    """Whether sources are to be rendered alone: there are pictures of all, and the options ask for it."""
    verdict = row_of(record)["verdict"]
    if options.superposition_of_all:
        return verdict in (SAME, DIFFERS)
    return options.superposition and verdict == DIFFERS


class _Reporter:
    """Writes what there is, whole, after every file."""

    def __init__(self, records: Records, root: Path, request: dict[str, Any], note: str):
        self._records, self._root, self._request, self._note = records, root, request, note

    def _known(self) -> list[Record]:
        """Records of the same request: others were rendered in another size, or with other samples."""
        return [record for record in self._records.all() if record.request == self._request]

    def write(self) -> dict[str, Any]:
        """Write the JSON and the page; returns the report."""
        known = self._known()
        report: dict[str, Any] = {
            "request": self._request,
            "versions": _versions(known),
            "note": self._note,
            "old": [record.name for record in known if record.has_old()],
            "summary": {},
            "files": [row_of(record) for record in known],
        }
        report["summary"] = summary_of(report["files"])
        folder = self._records.folder.parent
        text = json_text(report) + "\n"
        write_text(folder / "results.json", text)
        page = html_page(report, known, shlex.join(["compare.py", *sys.argv[1:]]))
        write_text(folder / "report.html", page)
        return report

    def write_table(self, report: dict[str, Any]) -> None:
        """Write docs/real-files.md and what belongs to it."""
        known = self._known()
        slugs = {record.name: RealFile(Path(), record.name).slug for record in known}
        write_manual(self._root, report, known, slugs)


def _kept_request(folder: Path) -> dict[str, Any]:
    """The request of the last comparison in `folder`; raises `UsageError` where there was none."""
    try:
        return json.loads((folder / "results.json").read_text(encoding="utf-8"))["request"]
    except (OSError, ValueError, KeyError):
        raise UsageError(f"there are no results in {folder}: render files first, with the same --out") from None


def _versions(records: list[Record]) -> dict[str, str]:
    """The versions that the files were rendered with; several where they changed on the way."""
    found: dict[str, set[str]] = {}
    for task in (task for record in records for task in record.tasks.values()):
        for name, version in task.get("versions", {}).items():
            found.setdefault(name, set()).add(version)
    return {name: " and ".join(sorted(several)) for name, several in found.items()}


def _text(report: dict[str, Any], folder: Path) -> str:
    lines = [counted(report["summary"]), *notes_of_old(report)]
    for name, ratio, interval, worst, worst_of, *_ in summary_rows(report["summary"]):
        compared = f"has {ratio} times that of" if name == VARIANCE else f"takes {ratio} times as long as"
        spread = f" ({interval}), at worst {worst} ({worst_of})" if len(report["files"]) > 1 else ""
        lines.append(f"{name}: RayBatch {compared} Cycles{spread}")
    lines.append(f"{folder / 'report.html'}")
    return "\n".join(lines)
