"""Kernels and functions of the core whose declaration waits until Warp needs it.

Warp reads and parses the source of each function where it is declared, and hashes all code of a kernel to find what was
compiled of it before: seconds for the thousand functions that a first render declares. Here a function is only noted,
and declared in full when anything is asked of it that was not noted. A kernel is launched without that where the hash
of its code is known by its identity (`identity.py`, `ready.py`).

This goes into Warp's own classes, so it is done for the version that it was made for alone, and only for what the core
declares. With another one all is declared at once.
"""

from __future__ import annotations

import functools
import itertools
import types
from typing import Any

import warp as wp

from .identity import UnknownError, identity_of, is_of_core
from .ready import KnownHash, KnownModule, forget_module, is_any_known, known_module, note_module

_WARP_VERSION = "1.19.0"
_codegen = wp._src.codegen
# Warp's own, where another import of this file has already wrapped them
_declare_function = getattr(wp.Function.__init__, "__wrapped__", wp.Function.__init__)
_declare_kernel = getattr(wp.Kernel.__init__, "__wrapped__", wp.Kernel.__init__)
_numbers = itertools.count(1)
declared_count = 0  # functions and kernels of the core that were declared in full


def unique_options(options: dict[str, Any]) -> dict[str, Any]:
    """Arguments of `wp.kernel` for a kernel with a module of its own that has `options`."""
    if not is_waiting():
        return {"module": "unique", "module_options": options, "enable_backward": False}
    return {"module": _Unique(options), "enable_backward": False}


def shared_module(name: str, options: dict[str, Any]) -> wp.Module:
    """The module `name`, for several kernels."""
    modules = wp._src.context.user_modules
    if is_waiting() and name not in modules:
        modules[name] = _Module(name, None)
    module = wp.get_module(name)
    module.options.update(options)
    return module


def declare_all(module: wp.Module) -> None:
    """Declare all kernels of `module` in full: its code is wanted."""
    if isinstance(module, _Module):
        module.declare()


def module_identity(module: wp.Module) -> str:
    """The identity of `module`, whose code was hashed; empty where it has none."""
    return module.identity if isinstance(module, _Module) else ""


def is_known(module: wp.Module, block_size: int) -> bool:
    """Whether the hash of `module` is known without declaring it."""
    return not isinstance(module, _Module) or module.is_known(block_size)


def has_entry_points(module: wp.Module, loaded: wp._src.context.ModuleExec) -> bool:
    """Whether what was loaded has the kernels of `module`; if not, what is known of it is dropped."""
    if not isinstance(module, _Module) or not module.goes_by_what_is_known:
        return True
    if all(loaded.get_kernel_hooks(kernel).forward for kernel in module.all_kernels):
        return True
    module.forget()
    return False


@functools.cache
def is_waiting() -> bool:
    """Whether declarations wait: with the version of Warp that this was made for."""
    return wp.config.version == _WARP_VERSION


class _Unique:
    """Stands for a module of a kernel's own."""

    def __init__(self, options: dict[str, Any]):
        self.options = options


class _Function(wp.Function):
    """A function that was noted. Once it is declared it is one of Warp's own class."""

    def __getattr__(self, name: str) -> Any:
        if name.startswith("__"):
            raise AttributeError(name)
        with _codegen._codegen_lock:
            if type(self) is _Function:
                _declare(self)
        return getattr(self, name)  # of the class that it has now


def _wait_for_declaration(self: Any, name: str) -> Any:
    """`__getattr__` of what is being declared: a thread that asks for what is not there yet waits for the end."""
    if name.startswith("__"):
        raise AttributeError(name)
    with _codegen._codegen_lock:
        if type(self) in (_FunctionAtWork, _KernelAtWork):
            raise AttributeError(name)
    return getattr(self, name)


class _FunctionAtWork(wp.Function):
    """A function while it is declared."""

    __getattr__ = _wait_for_declaration


class _KernelAtWork(wp.Kernel):
    """A kernel while it is declared."""

    __getattr__ = _wait_for_declaration


def _declare(function: _Function) -> None:
    """Declare `function` in full; where that fails, the next one who asks gets the same error."""
    global declared_count
    before = dict(vars(function))
    function.__class__ = _FunctionAtWork
    try:
        _declare_function(function, **before["_noted"], scope_locals={})
    except BaseException as error:
        function.__class__ = _Function
        vars(function).clear()
        vars(function).update(before)
        if isinstance(error, AttributeError):  # else it would seem that there is no such attribute
            raise RuntimeError(f"{function.key} cannot be declared: {error}") from error
        raise
    del function._noted
    vars(function).update({name: before[name] for name in functools.WRAPPER_ASSIGNMENTS if name in before})
    function.__class__ = wp.Function
    declared_count += 1


@functools.wraps(_declare_function)
def _note_function(self: wp.Function, func: Any, key: str, namespace: str, *rest: Any, **arguments: Any) -> None:
    scope = arguments.get("scope_locals")
    if (
        rest
        or not isinstance(func, types.FunctionType)
        or not is_of_core(func)
        or scope is None
        or isinstance(scope.get(func.__name__), wp.Function)  # it is an overload of that
        or arguments.get("module") is None
    ):
        _declare_function(self, func, key, namespace, *rest, **arguments)
        return
    del arguments["scope_locals"]
    self.__class__ = _Function
    noted = {"func": func, "key": key, "namespace": namespace, **arguments}
    vars(self).update(
        _noted=noted,
        func=func,
        key=key,
        inline_hint=arguments.get("inline_hint"),
        native_snippet=arguments.get("native_snippet"),
    )
    arguments["module"].functions[key] = self  # where Warp's decorator looks for it


class _Kernel(wp.Kernel):
    """A kernel that was noted. It can be launched; for all else it is declared, and is one of Warp's own class then."""

    def __getattr__(self, name: str) -> Any:
        if name.startswith("__"):
            raise AttributeError(name)
        with _codegen._codegen_lock:
            if type(self) is _Kernel and not (name in _DESCRIBED and self.module.describe(self)):
                self.module.declare()
        return getattr(self, name)


_DESCRIBED = ("adj", "is_generic", "grid_stride")


@functools.wraps(_declare_kernel)
def _note_kernel(self: wp.Kernel, func: Any, key: Any = None, module: Any = None, *rest: Any, **arguments: Any) -> None:
    options = arguments.get("options") or {}
    if isinstance(module, _Unique):
        unique, module = module, _Module(None, func.__name__ if key is None else key)
        module.options.update(unique.options)
    if rest or not isinstance(module, _Module) or not is_of_core(func) or set(arguments) - {"options"}:
        _declare_kernel(self, func, key, module, *rest, **arguments)
        return
    self.__class__ = _Kernel
    vars(self).update(
        func=func,
        module=module,
        key=key or _codegen.make_full_qualified_name(func),
        options=options,
        uses_warp_entry_point_abi=options.get("entry_point_abi", "warp") == "warp",
        sig="",
        overloads={},
        generic_parent=None,
        _hash=None,
        _mangled_name=None,
        _invoke_cache={},
    )
    module.note(self)


class _Signature:
    """The part of a kernel's code that a launch asks for. All else is that of the kernel when it is declared."""

    def __init__(self, kernel: _Kernel, arg_types: dict[str, Any], dimension: int):
        self._kernel = kernel
        self.arg_types = arg_types
        self.args = [_codegen.Var(name, each, requires_grad=False) for name, each in arg_types.items()]
        self.kernel_dim = dimension
        self.tid_extent_limit_candidate = _codegen._TID_MAX_EXTENT

    def __getattr__(self, name: str) -> Any:
        if name.startswith("__"):
            raise AttributeError(name)
        self._kernel.module.declare()
        return getattr(self._kernel.adj, name)


class _Module(wp.Module):
    """A module whose kernels wait. Its hash is that by which it is known, if it is; its name ends with the hash if it
    is a kernel's own.
    """

    def __init__(self, name: str | None, kernel_key: str | None):
        super().__init__(name)
        self.all_kernels: list[wp.Kernel] = []
        self.goes_by_what_is_known = False
        self._kernel_key = kernel_key
        self._trusts = True
        # of it and of its kernels; empty where unknown
        self._known_identities: tuple[str, list[str]] | None = None

    @property
    def name(self) -> str:
        """The module's name, as Warp names modules of one kernel."""
        if self._name is None:
            with _codegen._codegen_lock:
                known = self._known()
                self._name = known.name if known else f"{self._kernel_key}_{self.get_module_hash().hex()[:8]}"
                wp._src.context.user_modules.setdefault(self._name, self)
        return self._name

    @name.setter
    def name(self, name: str) -> None:
        self._name = None if name == "None" else name

    def note(self, kernel: wp.Kernel) -> None:
        """Add a kernel that waits."""
        self.all_kernels.append(kernel)
        self.kernels[kernel.key] = kernel
        self.mark_modified()

    def register_kernel(self, kernel: wp.Kernel) -> None:
        """Register a kernel as Warp does, also one that never waited."""
        if kernel not in self.all_kernels:
            self.all_kernels.append(kernel)
        super().register_kernel(kernel)

    def declare(self) -> None:
        """Declare all kernels in full."""
        global declared_count
        with _codegen._codegen_lock:
            for kernel in [each for each in self.all_kernels if type(each) is _Kernel]:
                before = dict(vars(kernel))
                kernel.__class__ = _KernelAtWork
                try:
                    _declare_kernel(kernel, kernel.func, key=kernel.key, module=self, options=before["options"])
                except BaseException as error:  # the next one who asks gets the same error
                    kernel.__class__ = _Kernel
                    vars(kernel).clear()
                    vars(kernel).update(before)
                    if isinstance(error, AttributeError):  # else it would seem that there is no such attribute
                        raise RuntimeError(f"{kernel.key} cannot be declared: {error}") from error
                    raise
                kernel.__class__ = wp.Kernel
                declared_count += 1
            self.goes_by_what_is_known = False

    def describe(self, kernel: wp.Kernel) -> bool:
        """Give `kernel` what a launch wants to know of it, if that is known."""
        known = self._known()
        if known is None:
            return False
        annotations = _codegen.get_full_arg_spec(kernel.func).annotations
        arg_types = {name: each for name, each in annotations.items() if name != "return"}
        if any(wp._src.types.type_is_generic(each) for each in arg_types.values()):
            return False
        identity = self._known_identities[1][self.all_kernels.index(kernel)]
        stride = wp._src.codegen.resolve_grid_stride(
            kernel.options, self.resolve_options(wp.config)["default_grid_stride"]
        )
        vars(kernel).update(
            adj=_Signature(kernel, arg_types, known.dimensions[identity]), is_generic=False, grid_stride=stride
        )
        return True

    @property
    def identity(self) -> str:
        """What it is known by; empty where nothing is."""
        with _codegen._codegen_lock:
            return self._identities()[0]

    def is_known(self, size: int) -> bool:
        """Whether its hash for blocks of `size` threads can be known without its code."""
        with _codegen._codegen_lock:
            if size in self.hashers:
                return True
            if self._kernel_key and not is_any_known(self._kernel_key):  # nobody needs to know which it is
                return False
            return (known := self._known()) is not None and size in known.hashes

    def forget(self) -> None:
        """What is known is wrong: hash the code from now on."""
        if self._known_identities:
            forget_module(self._known_identities[0])
        self._trusts = False
        self.execs = {}
        self.declare()
        self.mark_modified()

    def get_module_hash(self, block_dim: int | None = None) -> bytes:
        """The module's hash as Warp has it, by what is known where it is."""
        size = self.options["block_dim"] if block_dim is None else block_dim
        with _codegen._codegen_lock:
            if size in self.hashers and not self.has_unresolved_static_expressions:
                return self.hashers[size].get_hash()
            waits = any(type(each) is _Kernel for each in self.all_kernels)
            known = self._known() if waits else None
            if known and size in known.hashes:
                own, of_kernels = known.hashes[size]
                pairs = zip(self.all_kernels, self._known_identities[1], strict=True)
                self.hashers[size] = KnownHash(own, {each: bytes.fromhex(of_kernels[name]) for each, name in pairs})
                self.resolved_options[size] = self.resolve_options(wp.config, block_dim=size)
                self.goes_by_what_is_known = True
                return self.hashers[size].get_hash()
            identities = self._identities()
            self.declare()
            found = super().get_module_hash(size)
            self._known_identities = identities
            self._report(size)
            return found

    def mark_modified(self) -> None:
        super().mark_modified()
        self._known_identities = None

    def increment_id(self) -> int:
        """Two modules may have one name, as that of code that is the same."""
        return next(_numbers)

    def _run_codegen(self, options: dict[str, Any], is_cpu: bool) -> Any:
        self.declare()
        self.get_module_hash(options["block_dim"])
        return super()._run_codegen(options, is_cpu)

    def _get_kernel_tid_extent_limit(self, kernel: wp.Kernel, block_dim: int | None = None) -> int | None:
        self.declare()
        return super()._get_kernel_tid_extent_limit(kernel, block_dim)

    def _identities(self) -> tuple[str, list[str]]:
        if self._known_identities is None:
            try:
                options = self.resolve_options(wp.config, block_dim=0)
                self._known_identities = identity_of([(each.func, each.options) for each in self.all_kernels], options)
            except UnknownError:
                self._known_identities = "", []
        return self._known_identities

    def _known(self) -> KnownModule | None:
        """What is known of the module, if that is all that it takes."""
        own, of_kernels = self._identities()
        known = known_module(own) if own and self._trusts else None
        if known is None or not set(of_kernels) <= set(known.dimensions):
            return None
        return known if all(set(of_kernels) <= set(each) for _, each in known.hashes.values()) else None

    def _report(self, size: int) -> None:
        """Let others know what was hashed."""
        own, of_kernels = self._identities()
        if not own or any(each.is_generic for each in self.all_kernels):
            return
        hasher, pairs = self.hashers[size], list(zip(of_kernels, self.all_kernels, strict=True))
        hashes = {name: hasher.kernel_hashes[each].hex() for name, each in pairs}
        dimensions = {name: each.adj.kernel_dim for name, each in pairs}
        note_module(own, KnownModule(self.name, {size: (hasher.get_hash().hex(), hashes)}, dimensions))


if is_waiting():
    wp.Function.__init__ = _note_function
    wp.Kernel.__init__ = _note_kernel
