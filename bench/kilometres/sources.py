"""Source files that a module imports, directly or indirectly, and a hash of them."""

from __future__ import annotations

import ast
import hashlib
from collections.abc import Iterable, Iterator
from pathlib import Path

from bench.drives import ROOT


def imported(roots: Iterable[str], folder: Path = ROOT) -> dict[str, Path]:
    """Find the modules below `folder` that `roots` import, with the roots: {module: file}.

    Read from the source, so it does not depend on what the process has imported: imports inside
    functions and for type checking count as well. The `__init__` of a module's packages is
    included.
    """
    found: dict[str, Path] = {}
    pending = list(roots)
    while pending:
        name = pending.pop()
        file = None if name in found else _file(name, folder)
        if file is not None:
            found[name] = file
            pending += _names(ast.parse(file.read_bytes()))
            pending += [name.rpartition(".")[0]] if "." in name else []
    return dict(sorted(found.items()))


def digest(roots: Iterable[str], folder: Path = ROOT) -> str:
    """SHA-256 of the names and contents of all modules that `roots` import."""
    total = hashlib.sha256()
    for name, file in imported(roots, folder).items():
        total.update(f"{name}\0{hashlib.sha256(file.read_bytes()).hexdigest()}\0".encode())
    return total.hexdigest()


def _file(name: str, folder: Path) -> Path | None:
    path = folder.joinpath(*name.split("."))
    files = (path.with_suffix(".py"), path / "__init__.py")
    return next((file for file in files if file.is_file()), None)


def _names(tree: ast.Module) -> Iterator[str]:
    """Names of modules that a file may import: `from a import b` yields both a and a.b."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and node.module and not node.level:
            yield node.module
            yield from (f"{node.module}.{alias.name}" for alias in node.names)
