"""The identity of a kernel's code, found without reading its source: two kernels of one identity have the same code.

Warp distinguishes kernels by their source, which takes it milliseconds a function. Here the files of the core are taken
together by a digest of all they hold. Within these files a function is known by its place and its bytecode, and by what
it refers to: variables of the functions around it, globals, and annotations, which in turn may be functions.
"""

from __future__ import annotations

import dataclasses
import enum
import functools
import hashlib
import os
import sys
import types
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np
import warp as wp

_CORE = Path(__file__).parents[1]
_CORE_PREFIX = f"{_CORE}{os.sep}"
_PACKAGE = __name__.removesuffix("device.identity")  # Blender's extensions have other names
_SOURCES = (".py", ".h")
_PLAIN = (type(None), bool, int, float, str, bytes)
_MISSING = object()


class UnknownError(Exception):
    """Something whose identity cannot be found."""


@functools.cache
def sources_digest() -> str:
    """Digest of all sources of the core, as they are when this file is imported, before anything is declared; and of
    what else decides what they mean.
    """
    digest = hashlib.blake2b(digest_size=16)
    _add_folder(digest, str(_CORE))
    digest.update(repr((sys.version_info[:2], wp.config.version)).encode())
    return digest.hexdigest()


def sources_changed() -> bool:
    """Whether the files are others by now than when the digest was taken."""
    return sources_digest.__wrapped__() != sources_digest()


def _add_folder(digest: hashlib.blake2b, folder: str) -> None:
    with os.scandir(folder) as entries:
        named = [entry for entry in entries if not entry.name.startswith(".") and entry.name != "__pycache__"]
    found = sorted(named, key=lambda entry: entry.name)
    for entry in found:
        if entry.is_dir():
            digest.update(f"{entry.name}/".encode())
            _add_folder(digest, entry.path)
        elif entry.name.endswith(_SOURCES):
            with open(entry.path, "rb", buffering=0) as file:
                data = file.read()
            digest.update(f"{entry.name} {len(data)}\n".encode())
            digest.update(data)
    digest.update(b"/")


def is_of_core(function: types.FunctionType) -> bool:
    """Whether `function` is in a file of the core."""
    return function.__code__.co_filename.startswith(_CORE_PREFIX)


def identity_of(
    kernels: Iterable[tuple[types.FunctionType, dict[str, Any]]], options: dict[str, Any]
) -> tuple[str, list[str]]:
    """The identities of a module and of its kernels, which are given as functions with their options.

    The module's does not depend on the order of its kernels. Raises `UnknownError`.
    """
    identifier = _Identifier()
    digests = [
        _digest(identifier.of_warp(each) + identifier.value(sorted(own.items())).encode()) for each, own in kernels
    ]
    return _digest("\n".join([identifier.value(sorted(options.items())), *sorted(digests)]).encode()), digests


def _digest(data: bytes) -> str:
    return hashlib.blake2b(data, digest_size=16).hexdigest()


class _Identifier:
    """Finds the identity of one module; what it found it remembers, as nothing changes meanwhile."""

    def __init__(self):
        self._texts: dict[int, tuple[Any, str]] = {}  # by id, with the object, which must live as long
        self._functions: dict[int, tuple[types.FunctionType, bytes]] = {}

    def of_warp(self, function: types.FunctionType) -> bytes:
        """Digest of a function of the core that Warp compiles."""
        names = function.__globals__
        annotations = [f"{name}:{self.annotation(each, names)}" for name, each in function.__annotations__.items()]
        return self.function(function) + "\n".join(annotations).encode()

    def function(self, function: types.FunctionType) -> bytes:
        """Digest of a function of the core, without its annotations."""
        known = self._functions.get(id(function))
        if known is not None:
            return known[1]
        code = function.__code__
        if not is_of_core(function):
            raise UnknownError(f"{function.__qualname__} is not of the core")
        self._functions[id(function)] = function, f"inside {function.__qualname__}".encode()  # it may call itself
        parts = [code.co_filename[len(_CORE_PREFIX) :], str(code.co_firstlineno), function.__qualname__]
        parts += [repr(each) for each in code.co_consts if isinstance(each, _PLAIN)]
        parts += code.co_names
        if function.__defaults__:
            parts.append(self.value(function.__defaults__))
        for name, cell in zip(code.co_freevars, function.__closure__ or (), strict=True):
            try:
                value = cell.cell_contents
            except ValueError:
                raise UnknownError(f"{name} in {function.__qualname__} is not there yet") from None
            parts.append(f"{name}={self.value(value)}")
        names = function.__globals__
        for name in code.co_names:
            value = names.get(name, _MISSING)
            kind = type(value)
            # other values, as classes and modules, are what the sources say
            if kind in _PLAIN or kind is tuple or kind is types.FunctionType or isinstance(value, wp.Function):
                try:
                    parts.append(f"{name}={self.value(value)}")
                except UnknownError:
                    if kind not in (tuple, types.FunctionType):
                        raise
        digest = hashlib.blake2b("\n".join(parts).encode(), digest_size=16)
        digest.update(code.co_code)
        made = digest.digest()
        self._functions[id(function)] = function, made
        return made

    def annotation(self, value: Any, names: dict[str, Any]) -> str:
        """A type that arguments have; `names` are those that it may go by."""
        if isinstance(value, str):
            found = names.get(value)
            return value if found is None else f"{value} {self.annotation(found, {})}"
        known = self._texts.get(id(value))
        if known is None:
            try:
                text = wp._src.types.get_type_code(value) if value is not None else "None"
            except TypeError:
                raise UnknownError(f"the annotation {value!r}") from None
            if isinstance(value, wp._src.codegen.Struct):
                text += value.hash.hex()
            elif isinstance(dtype := getattr(value, "dtype", None), wp._src.codegen.Struct):
                text += dtype.hash.hex()
            known = self._texts[id(value)] = value, text
        return known[1]

    def value(self, value: Any) -> str:
        """A value that a function refers to."""
        if isinstance(value, _PLAIN) and type(value) in _PLAIN:
            return repr(value)
        known = self._texts.get(id(value))
        if known is None:
            known = self._texts[id(value)] = value, self._value(value)
        return known[1]

    def _value(self, value: Any) -> str:
        kind = type(value)
        if isinstance(value, wp.Function):
            return self._warp_function(value)
        if isinstance(value, types.FunctionType):
            return self.function(value).hex()
        if isinstance(value, wp._src.codegen.Struct):
            return value.native_name + value.hash.hex()
        if isinstance(value, enum.Enum):
            return f"{kind.__qualname__}.{value.name}={value.value!r}"
        if isinstance(value, (tuple, list)):
            return f"{kind.__name__}({','.join([self.value(each) for each in value])})"
        if isinstance(value, (set, frozenset)):
            return f"{kind.__name__}({','.join(sorted(self.value(each) for each in value))})"
        if isinstance(value, dict):
            return f"dict({','.join([f'{self.value(name)}:{self.value(each)}' for name, each in value.items()])})"
        if dataclasses.is_dataclass(value) and not isinstance(value, type):
            fields = [f"{each.name}={self.value(getattr(value, each.name))}" for each in dataclasses.fields(value)]
            return f"{kind.__qualname__}({','.join(fields)})"
        if isinstance(value, types.SimpleNamespace):
            return f"namespace({self.value(vars(value))})"
        if isinstance(value, types.ModuleType):
            return f"module {value.__name__.removeprefix(_PACKAGE)}"
        if isinstance(value, (np.ndarray, np.generic)) and value.dtype != object:
            return f"{value.dtype}{value.shape}{hashlib.blake2b(value.tobytes()).hexdigest()}"
        if isinstance(value, type) and value.__module__.startswith(_PACKAGE):
            return f"class {value.__module__.removeprefix(_PACKAGE)}.{value.__qualname__}"
        if hasattr(kind, "_wp_scalar_type_"):  # a vector or a matrix
            return self.annotation(kind, {}) + bytes(value).hex()
        return self.annotation(value, {})

    def _warp_function(self, function: wp.Function) -> str:
        if function.is_builtin():
            return f"builtin {function.key}"
        own = vars(function)
        overloads = [*own.get("user_overloads", {}).values(), *own.get("user_templates", {}).values()]
        if sum(each.generic_parent is None for each in overloads) > 1:  # others are made of generic ones
            raise UnknownError(f"{function.key} has overloads")
        return f"{self.of_warp(function.func).hex()} {function.inline_hint} {function.native_snippet}"


sources_digest()
