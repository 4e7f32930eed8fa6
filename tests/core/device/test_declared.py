"""Declarations wait until Warp needs them, and a kernel that is known by its identity is that of its code."""

import functools
import json
import os
import re
import shutil
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor, wait
from pathlib import Path

import numpy as np
import pytest
import warp as wp

from raybatch_addon.core.device import declared, identity, ready
from raybatch_addon.core.device.devices import is_compiled, load_kernels, load_module
from raybatch_addon.core.device.identity import UnknownError, identity_of
from raybatch_addon.core.device.kernel import KERNEL_OPTIONS
from tests.core.device.small_kernels import ROOT, files_of, keep_in

CPU = "cpu"
FACTOR = 2.0


@wp.struct
class Pair:
    """Two numbers."""

    first: float
    second: float


def make_kernel(number: float, of: type = float, helper=None) -> wp.Kernel:
    """A kernel that adds `number` times `FACTOR`."""

    @wp.func
    def added(value: float) -> float:
        return value + wp.static(number) * FACTOR

    inner = helper or added

    @wp.kernel(**KERNEL_OPTIONS)
    def add(values: wp.array(dtype=of)):
        i = wp.tid()
        values[i] = inner(values[i])

    return add


@pytest.fixture(autouse=True)
def folder(tmp_path, monkeypatch) -> Path:
    """A folder without kernels; this file is taken for one of the core."""
    if not declared.is_waiting():
        pytest.skip("declarations wait with one version of Warp alone")
    keep_in(tmp_path, monkeypatch)
    monkeypatch.setattr(identity, "_CORE_PREFIX", f"{Path(__file__).parent}{os.sep}")
    ready._new.clear()
    return tmp_path


def result_of(kernel: wp.Kernel) -> float:
    load_kernels([kernel], wp.get_device(CPU), lambda done, total: None)
    values = wp.zeros(3, dtype=float, device=CPU)
    wp.launch(kernel, 3, [values], device=CPU)
    return float(values.numpy()[2])


def module_identity(kernel: wp.Kernel) -> str:
    return identity_of([(kernel.func, kernel.options)], kernel.module.options)[0]


def test_a_declaration_waits_until_it_is_needed():
    before = declared.declared_count
    kernel = make_kernel(3.0)
    function = kernel.func.__closure__[0].cell_contents
    assert isinstance(kernel, wp.Kernel) and isinstance(function, wp.Function) and not function.is_builtin()
    assert function.__name__ == "added" and declared.declared_count == before
    assert list(function.input_types) == ["value"] and type(function) is wp.Function
    assert declared.declared_count == before + 1


def test_a_known_kernel_is_launched_without_its_code(folder):
    assert result_of(make_kernel(3.0)) == 6.0
    before = declared.declared_count
    kernel = make_kernel(3.0)
    assert is_compiled(kernel, wp.get_device(CPU), at_once=True)
    assert result_of(kernel) == 6.0
    assert declared.declared_count == before and len(list(folder.glob("known-*.json"))) == 1
    # its code is that by which it is known
    identifier = kernel.module.get_module_identifier(1)
    name, dimension = kernel.module.name, kernel.adj.kernel_dim
    declared.declare_all(kernel.module)
    assert type(kernel) is wp.Kernel and declared.declared_count > before
    assert (kernel.module.get_module_identifier(1), kernel.adj.kernel_dim) == (identifier, dimension)
    assert name.endswith(kernel.module.get_module_hash().hex()[:8])


def test_a_kernel_that_is_not_known_is_not_there_at_once():
    assert not is_compiled(make_kernel(4.0), wp.get_device(CPU), at_once=True)


def test_what_a_launch_does_not_need_is_declared_when_it_is_asked_for():
    assert result_of(make_kernel(3.0)) == 6.0
    kernel = make_kernel(3.0)
    assert [each.label for each in kernel.adj.args] == ["values"]
    before = declared.declared_count
    assert kernel.adj.source.lstrip().startswith("@wp.kernel") and declared.declared_count > before
    assert result_of(kernel) == 6.0


def test_identity_follows_all_that_code_is_made_of(monkeypatch):
    @wp.func
    def other(value: float) -> float:
        return value

    kernels = [make_kernel(3.0), make_kernel(4.0), make_kernel(3.0, Pair), make_kernel(3.0, helper=other)]
    reported = [module_identity(kernel) for kernel in kernels]
    assert len(set(reported)) == 4 and module_identity(make_kernel(3.0)) == reported[0]
    assert identity_of([(kernels[0].func, {"enable_backward": True})], kernels[0].module.options)[0] != reported[0]
    assert identity_of([(kernels[0].func, kernels[0].options)], {"fast_math": True})[0] != reported[0]
    monkeypatch.setitem(globals(), "FACTOR", 3.0)
    assert module_identity(kernels[0]) != reported[0] and result_of(make_kernel(3.0)) == 9.0


def test_identity_is_that_of_the_functions_not_of_their_order():
    first, second = make_kernel(3.0), make_kernel(4.0)
    pairs = [(each.func, each.options) for each in (first, second)]
    (one, each), (same, turned) = identity_of(pairs, {}), identity_of(pairs[::-1], {})
    assert one == same and each == turned[::-1]


def test_what_has_no_identity_is_declared():
    @wp.func
    def helper(value: float) -> float:
        return value + wp.static(opaque())

    def opaque() -> float:
        return things[0].number

    class Thing:
        number = 5.0

    things = [Thing()]
    kernel = make_kernel(1.0, helper=helper)
    with pytest.raises(UnknownError, match="Thing"):
        module_identity(kernel)
    assert result_of(kernel) == 5.0 and kernel.module.identity == ""


def known_file(folder: Path) -> Path:
    return next(folder.glob("known-*.json"))


def rewrite(path: Path, change) -> None:
    """Change what is known, with the right sum."""
    text = path.read_text().partition("\n")[2]
    text = change(text)
    path.write_text(f"{ready._sum(text)}\n{text}")


def spoil_kernel_hashes(text: str) -> str:
    """Well-formed entries that name kernels which are not in the binary."""
    entries = json.loads(text)
    for entry in entries.values():
        for _, kernels in entry["hashes"].values():
            kernels.update(dict.fromkeys(kernels, "00" * 32))
    return json.dumps(entries)


DAMAGES = {
    "cut": lambda path: path.write_bytes(path.read_bytes()[:100]),
    "empty": lambda path: path.write_bytes(b""),
    "a byte": lambda path: path.write_bytes(path.read_bytes().replace(b"dimensions", b"dimensiens", 1)),
    "not text": lambda path: path.write_bytes(bytes(range(256))),
    "other module": lambda path: rewrite(path, lambda text: re.sub(r'"[0-9a-f]{64}",\{', f'"{"00" * 32}",{{', text)),
    "other kernels": lambda path: rewrite(path, spoil_kernel_hashes),
    "no entries": lambda path: rewrite(path, lambda text: re.sub(r'"hashes":', '"nothing":', text)),
    "a list": lambda path: rewrite(path, lambda text: "[]"),
}


@pytest.mark.parametrize("damage", DAMAGES)
def test_where_what_is_known_is_damaged_the_code_decides(folder, damage):
    kernel = make_kernel(7.0)
    assert result_of(kernel) == 14.0
    identifier = kernel.module.get_module_identifier(1)
    DAMAGES[damage](known_file(folder))
    ready._read.clear()
    again = make_kernel(7.0)
    assert result_of(again) == 14.0 and again.module.get_module_identifier(1) == identifier
    assert sorted(folder.glob("wp_*")) == [files_of(kernel, folder).binary.parent]
    ready._read.clear()
    assert is_compiled(make_kernel(7.0), wp.get_device(CPU), at_once=True), "it was mended"


def test_what_is_known_but_was_removed_is_compiled(folder):
    kernel = make_kernel(7.0)
    assert result_of(kernel) == 14.0
    for path in files_of(kernel, folder).binary.parent.iterdir():
        path.unlink()
    again = make_kernel(7.0)
    assert not is_compiled(again, wp.get_device(CPU), at_once=True)
    assert result_of(again) == 14.0


def test_a_folder_that_cannot_be_written_costs_no_render(folder, monkeypatch):
    def full(path, entries):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(ready, "_write", full)
    assert result_of(make_kernel(3.0)) == 6.0 and not list(folder.glob("known-*"))


def test_the_states_of_the_sources_that_were_used_last_are_remembered(folder, monkeypatch):
    """One of them is only read, as that of an installation beside a clone that is worked on."""
    written = [f"known-{number:032x}.json" for number in range(ready._FILES_MOST + 3)]
    for name in ["known-read.json", *written]:
        monkeypatch.setattr(ready, "file_name", lambda name=name: name)
        note_something("0" * 32)
        monkeypatch.setattr(ready, "file_name", lambda: "known-read.json")
        ready._read.clear()  # as in a new process
        assert ready.known_module("0" * 32).name == "name"
    kept = ready._FILES_MOST - 1
    assert {path.name for path in folder.glob("known-*.json")} == {"known-read.json", *written[-kept:]}


def note_something(identity: str = "1" * 32) -> None:
    ready.note_module(identity, ready.KnownModule("name", {1: ("00" * 32, {})}, {}))
    ready.write_notes()


def test_what_was_hashed_while_sources_changed_is_not_kept(folder, monkeypatch):
    sources = folder / "sources"
    (sources / "ops").mkdir(parents=True)
    (sources / "ops" / "math.py").write_text("x = 1")
    monkeypatch.setattr(identity, "_CORE", sources)
    monkeypatch.setattr(identity, "sources_digest", functools.cache(identity.sources_digest.__wrapped__))
    note_something()
    before = known_file(folder).read_bytes()
    (sources / "ops" / "math.py").write_text("x = 2")
    note_something("2" * 32)
    assert known_file(folder).read_bytes() == before and ready.known_module("2" * 32) is None
    (sources / "ops" / "math.py").write_text("x = 1")
    note_something("3" * 32)
    assert ready.known_module("3" * 32) and ready.known_module("1" * 32) and ready.known_module("2" * 32) is None


# Writes a hundred notes into the folder sys.argv[1], one after another; their identities begin with sys.argv[2]
WRITER = """
import sys, time
import warp as wp
from raybatch_addon.core.device import ready
wp.config.kernel_cache_dir = sys.argv[1]
ready.sources_changed = lambda: False
write = ready._write
def write_slowly(path, entries):  # others have time to write meanwhile
    time.sleep(0.001)
    write(path, entries)
ready._write = write_slowly
print("ready", flush=True)
sys.stdin.readline()
for number in range(100):
    ready.note_module(f"{sys.argv[2]}{number}", ready.KnownModule("name", {1: ("00" * 32, {})}, {}))
    ready.write_notes()
"""


def test_processes_that_write_at_once_lose_no_notes_of_each_other(folder):
    pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "text": True, "cwd": ROOT}
    writers = [subprocess.Popen([sys.executable, "-c", WRITER, folder, name], **pipes) for name in "ab"]
    assert [writer.stdout.readline() for writer in writers] == ["ready\n"] * 2
    for writer in writers:
        writer.stdin.write("\n")
        writer.stdin.flush()
    for writer in writers:
        writer.communicate()
    lost = [f"{name}{number}" for name in "ab" for number in range(100) if not ready.known_module(f"{name}{number}")]
    assert lost == []


@pytest.mark.parametrize("error", [ValueError, AttributeError])
@pytest.mark.parametrize("what", ["kernel", "function"])
def test_a_declaration_that_fails_is_reported_to_each_who_asks(what, error, monkeypatch):
    bad, good = make_kernel(5.0), make_kernel(3.0)
    wanted = bad if what == "kernel" else bad.func.__closure__[0].cell_contents
    declare, device = getattr(declared, f"_declare_{what}"), wp.get_device(CPU)

    def fail(self, *arguments, **options):
        if self is wanted:
            raise error("out of numbers")
        declare(self, *arguments, **options)

    with monkeypatch.context() as patch:
        patch.setattr(declared, f"_declare_{what}", fail)
        for ask in (lambda: hasattr(wanted, "adj"), *[lambda: load_module(bad, device)] * 2):
            with pytest.raises(Exception, match="out of numbers"):
                ask()
        assert result_of(good) == 6.0, "others go on"
    assert result_of(bad) == 10.0, "and so does this one, once the cause is gone"


@pytest.mark.parametrize("what", ["kernel", "function"])
def test_who_asks_while_another_thread_declares_waits_for_it(what, monkeypatch):
    kernel, asked, declare = make_kernel(6.0), [], getattr(declared, f"_declare_{what}")
    wanted = kernel if what == "kernel" else kernel.func.__closure__[0].cell_contents
    with ThreadPoolExecutor(1) as pool:

        def slowly(self, *arguments, **options):
            if self is wanted and not asked:
                asked.append(pool.submit(lambda: wanted.adj))
                wait(asked, 0.2)
            declare(self, *arguments, **options)

        monkeypatch.setattr(declared, f"_declare_{what}", slowly)
        assert wanted.adj is asked[0].result() and type(wanted) in (wp.Kernel, wp.Function)


def test_several_threads_may_ask_first():
    kernels = [make_kernel(float(number)) for number in range(4)] * 2
    with ThreadPoolExecutor(8) as pool:
        list(pool.map(lambda kernel: load_module(kernel, wp.get_device(CPU)), kernels))
    assert [result_of(kernel) for kernel in kernels] == [0.0, 2.0, 4.0, 6.0] * 2


# A process that renders with general kernels; says what it declared, its film and names of modules
PROCESS = """
import hashlib, sys
import warp as wp
version = wp.config.version
if "other version" in sys.argv:
    wp.config.version += "+other"
from raybatch_addon.core.device import declared
wp.config.version = version
from raybatch_addon.core.device.identity import sources_digest
from raybatch_addon.core.device.kernel import GENERAL_MODULE
from raybatch_addon.core.session import Session
from raybatch_addon.core.settings.settings import RenderSettings
from raybatch_addon.core.wavefront.tier import general_kernels
from tests.support import scenes
session = Session("cpu", cache_folder=sys.argv[1])
digest = ""
if "no render" not in sys.argv:
    film = session.render(scenes.mixed(), RenderSettings(sample_count=2, kernel_tier="GENERAL"))
    digest = hashlib.sha256(film.passes["Combined"].tobytes()).hexdigest()
count = declared.declared_count
print(count, sources_digest(), general_kernels(session.device)[0].module.get_module_identifier(1), digest or "-")
"""


def run_process(root: Path, folder: Path, *words: str) -> list[str]:
    environment = os.environ | {"PYTHONPATH": os.pathsep.join([str(root), str(ROOT), os.environ.get("PYTHONPATH", "")])}
    command = [sys.executable, "-c", PROCESS, str(folder), *words]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, cwd=root)
    assert done.returncode == 0, done.stderr
    return done.stdout.split()


@pytest.mark.usefixtures("cpu_compiler")
def test_a_render_with_kernels_that_are_ready_declares_nothing(session, monkeypatch):
    """The kernels are those of the suite's own folder, which the first process may complete."""
    monkeypatch.undo()
    folder = Path(wp.config.kernel_cache_dir).parent
    first, second = run_process(ROOT, folder), run_process(ROOT, folder)
    assert second[0] == "0" and first[1:] == second[1:]


@pytest.mark.thorough  # declares everything twice
def test_another_version_of_warp_declares_all_at_once_and_finds_the_same_hash(tmp_path):
    waits, other = (run_process(ROOT, tmp_path, "no render", *words) for words in ((), ("other version",)))
    assert other[0] == "0" and waits[2] == other[2]


@pytest.mark.thorough  # declares everything three times
def test_a_changed_source_is_noticed(tmp_path):
    shutil.copytree(ROOT / "raybatch_addon", tmp_path / "raybatch_addon", ignore=shutil.ignore_patterns("__pycache__"))
    before = run_process(tmp_path, tmp_path / "kernels", "no render")
    changes = tmp_path / "raybatch_addon" / "core" / "programs" / "ops" / "values" / "math.py"
    text = changes.read_text()
    changed = re.sub(r"return wp\.sin\(", "return wp.cos(", text, count=1)  # one constant, at the same place
    assert changes.write_text(changed) and changed != text
    after = run_process(tmp_path, tmp_path / "kernels", "no render")
    assert before[1] != after[1] and before[2] != after[2]
    changes.write_text(text)
    assert run_process(tmp_path, tmp_path / "kernels", "no render")[1:3] == before[1:3]


def test_bytecode_that_is_not_the_sources_is_noticed():
    """Bytecode differs like this in a session whose files were changed after they were imported."""
    kernel = make_kernel(3.0)
    reported = module_identity(kernel)
    kernel.func.__code__ = kernel.func.__code__.replace(co_consts=(*kernel.func.__code__.co_consts, "other"))
    assert module_identity(kernel) != reported


def test_floats_are_distinguished_to_the_last_bit():
    assert module_identity(make_kernel(0.1)) != module_identity(make_kernel(float(np.nextafter(0.1, 1.0))))
    assert module_identity(make_kernel(0.0)) != module_identity(make_kernel(-0.0))
