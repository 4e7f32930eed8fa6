"""The files that are to be compared: named one by one, or by a list that says where each comes from."""

from __future__ import annotations

import hashlib
import json
import re
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from lib.blend_files import unlike_blend
from lib.command import UsageError

# Licences that allow pictures of a file to be shown; all but CC0 ask for the name of who made it
SHOWN = re.compile(r"CC0(-1\.0)?|CC-BY(-\d\.\d)?")


@dataclass(frozen=True)
class RealFile:
    """A file, and what is known of it."""

    path: Path
    name: str  # of its row, and of its records; no two files have the same
    about: dict[str, Any] = field(default_factory=dict)  # its entry in the list, if it comes from one

    @property
    def slug(self) -> str:
        """The name as part of a file's name."""
        short = re.sub(r"[^A-Za-z0-9]+", "-", self.name).strip("-").lower()[:60]
        return f"{short}-{hashlib.md5(self.name.encode()).hexdigest()[:6]}"

    def complaint(self) -> str:
        """What is wrong with the file, and what to do about it; empty if it can be tried."""
        if not self.path.exists():
            if self.about:
                return (
                    f"{self.path} is not there: get {self.about['path']} of commit {self.about['commit'][:12]} of "
                    f"https://github.com/{self.about['repository']}, and put it there"
                )
            return f"there is no file {self.path}: check the name"
        if self.path.is_dir():
            return f"{self.path} is a folder: name the .blend files in it"
        try:
            unlike = unlike_blend(self.path)
        except OSError as error:
            return f"{self.path} cannot be read ({error.strerror}): check its permissions"
        if unlike:
            return f"{self.path} {unlike}"
        expected = self.about.get("md5")
        if expected and (found := self.md5()) != expected:
            return (
                f"{self.path} is another version than the list means (MD5 {found}, not {expected}): get it of commit "
                f"{self.about['commit'][:12]}"
            )
        return ""

    def md5(self) -> str:
        """MD5 of the file's bytes."""
        with open(self.path, "rb") as opened:
            return hashlib.file_digest(opened, "md5").hexdigest()


def files_named(paths: list[str]) -> list[RealFile]:
    """Files by their paths, each called as the last parts of its path that no other file shares."""
    absolute = list(dict.fromkeys(Path(each).absolute() for each in paths))
    names: dict[Path, str] = {}
    for path in absolute:
        parts = 1
        while any(other.parts[-parts:] == path.parts[-parts:] for other in absolute if other != path):
            parts += 1
        names[path] = "/".join(path.parts[-parts:])
    return [RealFile(path, names[path]) for path in absolute]


def files_listed(listing: Path, folder: Path, only: list[str]) -> list[RealFile]:
    """Files of a list as docs/real-files.json, each in `folder` as OWNER+NAME/PATH or OWNER/NAME/PATH; `only`: those
    with one of these parts in their names, if there are any. Raises `UsageError`.
    """
    files = []
    for entry in read_listing(listing):
        name = name_of(entry)
        places = [folder / entry["repository"].replace("/", "+") / entry["path"], folder / name]
        path = next((each for each in places if each.exists()), places[0])
        if not only or any(part.lower() in name.lower() for part in only):
            files.append(RealFile(path, name, entry))
    if not files:
        raise UsageError(f"no file of {listing} has {' or '.join(only)} in its name: look them up there")
    return files


def read_listing(listing: Path) -> list[dict[str, Any]]:
    """The entries of a list as docs/real-files.json; raises `UsageError`."""
    try:
        entries = json.loads(listing.read_text(encoding="utf-8"))["files"]
        for entry in entries:
            for key in ("repository", "commit", "path", "md5", "licence"):
                if not isinstance(entry[key], str):
                    raise TypeError(key)
    except OSError as error:
        raise UsageError(f"the list {listing} cannot be read ({error.strerror or error}): check its name") from None
    except (ValueError, KeyError, TypeError) as error:
        raise UsageError(
            f"{listing} is no list of files ({type(error).__name__}: {error}): it needs “files”, each with repository, "
            "commit, path, md5 and licence, as docs/real-files.json has them"
        ) from None
    return entries


def name_of(entry: dict[str, Any]) -> str:
    """The name of an entry's file: OWNER/NAME/PATH."""
    return f"{entry['repository']}/{entry['path']}"


def names_that_differ(entries: list[dict[str, Any]]) -> set[str]:
    """Names of the files of a list whose finding says which engine is right: their pictures differ, also where the
    noise of a comparison hides it.
    """
    return {name_of(each) for each in entries if each.get("finding", {}).get("right")}


def names_that_ask(entries: list[dict[str, Any]]) -> set[str]:
    """Names of the files of a list whose entry says that they ask for more than surfaces, as hair or volumes."""
    return {name_of(each) for each in entries if each.get("asks")}


def may_be_shown(about: dict[str, Any]) -> bool:
    """Whether the licence allows pictures of the file in a document."""
    return SHOWN.fullmatch(about.get("licence", "")) is not None
