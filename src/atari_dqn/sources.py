"""The project's own source files, and which of them import which."""

import ast
from pathlib import Path

PACKAGE = Path(__file__).parent


def modules() -> dict[str, Path]:
    """{name: file} of every module."""
    single = {path.stem: path for path in PACKAGE.glob("*.py")}
    packages = {path.parent.name: path for path in PACKAGE.glob("*/__init__.py")}
    return dict(sorted((single | packages).items()))


def imports(code: str) -> set[str]:
    """The project's modules that some code imports."""
    found: set[str] = set()
    for node in ast.walk(ast.parse(code)):
        if isinstance(node, ast.ImportFrom) and node.module:
            package, _, submodule = node.module.partition(".")
            if package == "atari_dqn":
                found |= {submodule} if submodule else {name.name for name in node.names}
    return found


def graph() -> dict[str, set[str]]:
    """{module: those that it imports}."""
    return {
        name: imports(path.read_text(encoding="utf-8")) & modules().keys()
        for name, path in modules().items()
    }
