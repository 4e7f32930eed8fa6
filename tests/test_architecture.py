"""The laws of the source itself: who may import whom, how large a file and a kernel may be."""

import ast
import functools
import graphlib
import re
import subprocess
import sys
from collections import Counter, defaultdict
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
PACKAGE = ROOT / "raybatch_addon"
FILES = sorted(PACKAGE.rglob("*.py"))
CORE_FILES = sorted((PACKAGE / "core").rglob("*.py"))
# each file below is an entry of a menu, which Blender makes of the folder
MENUS = PACKAGE / "presets" / "raybatch"
FOLDERS = sorted({path.parent for path in FILES if MENUS not in path.parents})
SCRIPTS = sorted((ROOT / "scripts").rglob("*.py"))
CODE = [*FILES, *SCRIPTS, *sorted((ROOT / "tests").rglob("*.py"))]

# A file imports only from its own room and from those above it.
ROOMS = (
    "core/attributes.py",
    "core/errors.py",
    "core/files.py",
    "core/float32.py",
    "core/version.py",
    "core/host_memory.py",
    "core/native",
    "core/settings",
    "core/device",
    "core/kept_arrays.py",
    "core/rays.py",
    "core/scene",
    "core/denoise",
    "core/sky",
    "core/bvh",
    "core/shading",
    "core/programs",
    "core/displacement",
    "core/shading/lights",
    "core/film",
    "core/measure",
    "core/observers.py",
    "core/convergence",
    "core/wavefront",
    "core/checkpoint",
    "core/ahead",
    "core/job.py",
    "core/session_device.py",
    "core/session.py",
    "core/cluster",
    "core/tuning.py",
    "core/live",
    "core/__init__.py",
    "convergence",
    "blender/__init__.py",
    "blender/denoise_library.py",
    "export",
    "blender/reports.py",
    "blender/checkpoints.py",
    "blender/exit_code.py",
    "blender/status",
    "blender/missing.py",
    "blender/kernel_cache.py",
    "blender/general_kernels.py",
    "blender/finals.py",
    "blender/sessions.py",
    "blender/cluster",
    "blender/viewport",
    "blender/warm_up.py",
    "blender/devices.py",
    "blender/viewport/callbacks.py",
    "blender/tuning.py",
    "blender/result.py",
    "blender/denoising.py",
    "blender/preview.py",
    "ui",
    "presets",
    "blender/frame.py",
    "engine.py",
    "__init__.py",
)
LINES_MAX = 400
FOLDER_FILES_MAX = 16  # of code in one folder, beside `__init__.py`
KERNEL_PARAMETERS_MAX = 8
NATIVE_PARAMETERS_MAX = 8
FUNCTION_PARAMETERS_MAX = 12  # of Warp's functions: compilers inline them, and what belongs together is a struct
WIDE_FIELDS = 8  # of a dataclass or a named tuple, or arguments of a call, from which on they are given by name
# Constants that each file has of its own: of a format, an environment variable, a type variable, and what the engine is
# called where a person reads it and where Blender does
OF_EACH_FILE = {"FORMAT", "VERSION", "VARIABLE", "T", "ENGINE"}
# A lambda of C++: its name, and its parameters
LAMBDA = re.compile(r"(\w+) = \[[&=]?\]\s*\(([^()]*)\)")


def name_of(path: Path) -> str:
    return path.relative_to(PACKAGE).as_posix()


def room_of(path: Path) -> int:
    name = name_of(path)
    found = [room for room in ROOMS if name == room or name.startswith(f"{room}/")]
    if found:
        return ROOMS.index(max(found, key=len))
    raise AssertionError(f"{name} belongs to no room: give it a place in ROOMS (and in the architecture page)")


@functools.cache
def parsed(path: Path) -> ast.Module:
    return ast.parse(path.read_text(encoding="utf-8"), str(path))


@functools.cache
def nodes_of(path: Path) -> list[ast.AST]:
    return list(ast.walk(parsed(path)))


@functools.cache
def import_targets(path: Path) -> set[Path]:
    """Files of the package that `path` imports, wherever in it the import stands."""
    targets = set()
    for node in nodes_of(path):
        if not isinstance(node, ast.ImportFrom) or node.level == 0:
            continue
        base = path.parent
        for _ in range(node.level - 1):
            base = base.parent
        base = base.joinpath(*(node.module or "").split("."))
        for name in (alias.name for alias in node.names):
            places = (base / f"{name}.py", base / name / "__init__.py", base.with_suffix(".py"), base / "__init__.py")
            found = [p for p in places if p.is_file()]
            assert found, f"{name_of(path)} imports {name} from {base}, which is not there"
            targets |= {found[0], defining(found[0], name)}
    return targets - {path}


def defining(file: Path, name: str) -> Path:
    """Where `name` comes from that is imported from `file`: another file, if that is an `__init__.py` which imports
    it.
    """
    if file.name != "__init__.py":
        return file
    for node in parsed(file).body:
        if isinstance(node, ast.ImportFrom) and node.level == 1 and node.module:
            if name in {alias.asname or alias.name for alias in node.names}:
                return file.parent.joinpath(*node.module.split(".")).with_suffix(".py")
    return file


def callee_of(node: ast.expr) -> str:
    """What `node` calls; "" where it is no call."""
    return ast.unparse(node.func) if isinstance(node, ast.Call) else ""


def absolute_imports(path: Path) -> set[str]:
    """Top-level names of the packages that `path` imports by absolute name."""
    names = set()
    for node in nodes_of(path):
        if isinstance(node, ast.Import):
            names |= {alias.name.split(".")[0] for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.level == 0:
            names.add(node.module.split(".")[0])
    return names


def test_imports_go_up_the_rooms():
    for path in FILES:
        for target in import_targets(path):
            assert room_of(target) <= room_of(path), f"{name_of(path)} imports {name_of(target)}, of a later room"


def test_files_import_each_other_in_no_circle():
    """Not for their types either: what several need has a file of its own."""
    imported = {path: import_targets(path) for path in FILES if path.name != "__init__.py"}
    graphlib.TopologicalSorter({path: targets & imported.keys() for path, targets in imported.items()}).prepare()


def test_imports_within_the_package_are_relative():
    assert not [name_of(path) for path in FILES if PACKAGE.name in absolute_imports(path)]


def test_the_core_knows_nothing_of_blender():
    for path in CORE_FILES:
        assert not absolute_imports(path) & {"bpy", "mathutils", "bl_ui", "bpy_types"}, name_of(path)
        assert all(PACKAGE / "core" in target.parents for target in import_targets(path)), name_of(path)


def test_only_export_reads_blenders_scene_and_only_result_writes_its_pixels():
    for path in FILES:
        text = path.read_text(encoding="utf-8")
        room = ROOMS[room_of(path)]
        if room != "export":
            assert ".foreach_get(" not in text and "object_instances" not in text, name_of(path)
        if room != "blender/result.py":
            assert "begin_result" not in text and ".foreach_set(" not in text, name_of(path)


def test_the_core_works_where_bpy_cannot_be_imported():
    code = """
import pkgutil, sys
for name in ("bpy", "mathutils"):
    sys.modules[name] = None  # importing it raises
import raybatch_addon.core as core
for module in pkgutil.walk_packages(core.__path__, core.__name__ + "."):
    __import__(module.name)
import numpy as np
from raybatch_addon.core.scene.description import Camera, CameraKind, Frame, Scene, World
from raybatch_addon.core.session import Session
from raybatch_addon.core.settings.settings import RenderSettings
camera = Camera(CameraKind.PERSPECTIVE, np.eye(3, 4, dtype=np.float32), (-1, 1, -1, 1))
film = Session("cpu", RenderSettings(sample_count=1)).render(Scene(camera, Frame(4, 4), world=World((1.0, 0.5, 0.25))))
assert np.allclose(film.passes["Combined"][..., :3], (1, 0.5, 0.25))
"""
    done = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr


def test_files_are_short():
    counts = {path: len(path.read_text(encoding="utf-8").splitlines()) for path in CODE}
    long = {path.relative_to(ROOT).as_posix(): count for path, count in counts.items() if count >= LINES_MAX}
    assert not long, f"{LINES_MAX} lines or more: {long}"


def test_folders_hold_few_files():
    counts = Counter(path.parent for path in CODE if path.name != "__init__.py")
    counts.update(path.parent for path in (*PACKAGE.rglob("*.h"), *(ROOT / "scripts").rglob("*.sh")))
    full = {folder.relative_to(ROOT).as_posix(): count for folder, count in counts.items() if count > FOLDER_FILES_MAX}
    assert not full, f"more than {FOLDER_FILES_MAX} files: make folders of one idea each in {full}"


def test_every_folder_says_in_one_sentence_what_it_is():
    for folder in FOLDERS:
        about = " ".join((ast.get_docstring(parsed(folder / "__init__.py")) or "").split())
        assert re.fullmatch(r"(?:(?![.!?]\s+[A-Z`]).)*\.", about), f"{name_of(folder)}/__init__.py says: {about!r}"


def public_definitions(path: Path) -> list[str]:
    """Names of the top-level functions and classes of `path`; without handlers of Blender's nodes, which are called
    what their node is called, and the two functions by which Blender adds and removes an add-on's parts.
    """
    names = []
    for node in parsed(path).body:
        if not isinstance(node, (ast.FunctionDef, ast.ClassDef)) or node.name.startswith("_"):
            continue
        handles_node = any(
            isinstance(each, ast.Call) and ast.unparse(each.func) in ("shader", "values")
            for each in node.decorator_list
        )
        if not handles_node and node.name not in ("register", "unregister"):
            names.append(node.name)
    return names


def is_assigned(node: ast.AST) -> bool:
    """Whether `node` is a name that gets a value: not that of a table of which an entry does."""
    return isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store)


def public_constants(path: Path) -> list[str]:
    """Names in capitals that `path` gives a value at its top level."""
    targets = [
        target
        for node in parsed(path).body
        if isinstance(node, (ast.Assign, ast.AnnAssign))
        for target in (node.targets if isinstance(node, ast.Assign) else [node.target])
    ]
    names = {each.id for target in targets for each in ast.walk(target) if is_assigned(each)}
    return sorted(name for name in names if name.isupper() and not name.startswith("_") and name not in OF_EACH_FILE)


def test_nothing_is_defined_twice_under_one_public_name():
    places = defaultdict(list)
    for path in FILES:
        for name in (*public_definitions(path), *public_constants(path)):
            places[name].append(name_of(path))
    twice = {name: files for name, files in places.items() if len(files) > 1}
    assert not twice, twice


def test_kernels_are_declared_with_the_cores_options_and_have_few_parameters():
    for path in CORE_FILES:
        bodies, called = {}, []
        for node in nodes_of(path):
            if isinstance(node, ast.FunctionDef):
                bodies[node.name] = len(node.args.args)
                decorators = map(ast.unparse, node.decorator_list)
                called += [(each, node.name) for each in decorators if "wp.kernel" in each]
            elif isinstance(node, ast.Call) and ast.unparse(node.func) == "wp.kernel" and node.args:
                called.append((f"wp.kernel({ast.unparse(node.keywords[0])})", ast.unparse(node.args[0])))
        for found, name in called:
            found = re.sub(r"general_options\('\w+', of\)", "KERNEL_OPTIONS", found)
            found = found.replace("kernel_options(out_of_line)", "KERNEL_OPTIONS")
            assert found == "wp.kernel(**KERNEL_OPTIONS)", f"{name_of(path)}: {name}"
            assert bodies[name] <= KERNEL_PARAMETERS_MAX, f"{name_of(path)}: {name}"


def test_native_functions_have_few_parameters():
    for path in CORE_FILES:
        for node in nodes_of(path):
            if isinstance(node, ast.FunctionDef) and any("func_native" in ast.unparse(d) for d in node.decorator_list):
                assert len(node.args.args) <= NATIVE_PARAMETERS_MAX, f"{name_of(path)}: {node.name}"


def test_native_code_comes_from_headers_alone():
    """A native function takes a plain `native_source(...)`, or what a function of its file returns, which is one."""
    for path in CORE_FILES:
        functions = [node for node in nodes_of(path) if isinstance(node, ast.FunctionDef)]
        returned = {each.name: [n.value for n in ast.walk(each) if isinstance(n, ast.Return)] for each in functions}
        for native in nodes_of(path):
            if isinstance(native, ast.Call) and ast.unparse(native.func).endswith("func_native"):
                source = [*native.args, *(each.value for each in native.keywords)][0]
                made = returned.get(callee_of(source), [source])
                assert {callee_of(each) for each in made} == {"native_source"}, f"{name_of(path)}: {native.lineno}"


def test_functions_of_kernels_have_few_parameters():
    for path in CORE_FILES:
        for node in nodes_of(path):
            if isinstance(node, ast.FunctionDef) and "wp.func" in map(ast.unparse, node.decorator_list):
                assert len(node.args.args) <= FUNCTION_PARAMETERS_MAX, f"{name_of(path)}: {node.name}"


def test_lambdas_of_headers_have_few_parameters():
    counts = {}
    for path in sorted(PACKAGE.rglob("*.h")):
        for name, parameters in LAMBDA.findall(path.read_text(encoding="utf-8")):
            listed = re.sub(r"<[^<>]*>", "", parameters).split(",")
            counts[f"{name_of(path)}: {name}"] = len([each for each in listed if each.strip()])
    assert counts["core/native/traverse/triangle.h: meet_triangle"] == 7, "lambdas are not seen any more"
    assert not {name: count for name, count in counts.items() if count > NATIVE_PARAMETERS_MAX}


def test_wide_dataclasses_are_built_by_keywords():
    """At most the first few fields of a wide dataclass are given by their order."""
    for path in [*FILES, *SCRIPTS]:
        for node in nodes_of(path):
            if not isinstance(node, ast.ClassDef):
                continue
            decorators = [ast.unparse(each) for each in node.decorator_list]
            types = [ast.unparse(each.annotation) for each in node.body if isinstance(each, ast.AnnAssign)]
            by_order = types.index("KW_ONLY") if "KW_ONLY" in types else len(types)
            if any(each.startswith("dataclass") and "kw_only=True" not in each for each in decorators):
                assert by_order < WIDE_FIELDS, f"{path}: {node.name} is built by the order of {by_order} fields"


def wide_tuples() -> set[str]:
    """Names of the named tuples that have as many fields as a wide dataclass."""
    names = set()
    for path in [*FILES, *SCRIPTS]:
        for node in nodes_of(path):
            if isinstance(node, ast.ClassDef) and "NamedTuple" in map(ast.unparse, node.bases):
                if sum(isinstance(each, ast.AnnAssign) for each in node.body) >= WIDE_FIELDS:
                    names.add(node.name)
    return names


def calls_by_name(tree: ast.Module) -> list[tuple[str, list[ast.expr]]]:
    """Names that Python code calls, and what it gives by order; code of kernels, which has no keywords, is left out."""
    of_kernels = {
        id(each)
        for node in ast.walk(tree)
        if isinstance(node, ast.FunctionDef) and any("wp." in ast.unparse(d) for d in node.decorator_list)
        for each in ast.walk(node)
    }
    return [
        (node.func.id, node.args)
        for node in ast.walk(tree)
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and id(node) not in of_kernels
    ]


def test_wide_calls_give_their_arguments_by_name():
    tuples, found = wide_tuples(), {}
    assert "Bsdf" in tuples, "named tuples are not seen any more"
    for path in [*FILES, *SCRIPTS]:
        for name, given in calls_by_name(parsed(path)):
            starred = sum(isinstance(each, ast.Starred) for each in given)
            if len(given) - starred >= WIDE_FIELDS or (starred and name in tuples):
                found[f"{path.relative_to(ROOT).as_posix()}: {name}"] = len(given)
    assert not found, f"give the last arguments by name in {found}"


def test_files_and_public_definitions_say_what_they_are():
    for path in FILES:
        tree = parsed(path)
        assert not tree.body or ast.get_docstring(tree), f"{name_of(path)} does not say what it is for"
        for node in tree.body:
            native = any("func_native" in ast.unparse(decorator) for decorator in getattr(node, "decorator_list", []))
            if isinstance(node, (ast.FunctionDef, ast.ClassDef)) and not node.name.startswith("_") and not native:
                assert ast.get_docstring(node), f"{name_of(path)}: {node.name}"


def test_a_room_that_reaches_down_would_be_found():
    """The walk itself sees imports in functions and of modules by name."""
    assert PACKAGE / "engine.py" in import_targets(PACKAGE / "__init__.py")
    assert PACKAGE / "blender" / "frame.py" in import_targets(PACKAGE / "engine.py")
    assert PACKAGE / "core" / "settings" / "settings.py" in import_targets(PACKAGE / "core" / "session.py")
