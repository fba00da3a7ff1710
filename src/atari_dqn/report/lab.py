"""Saving notebooks in JupyterLab."""

from typing import Any

from atari_dqn.runs.files import project_root

METADATA = {
    "kernelspec": {"display_name": "Python 3", "language": "python", "name": "python3"},
    "language_info": {"name": "python"},
}


def without_outputs(model: dict[str, Any], path: str, contents_manager: Any, **_: Any) -> None:
    """Leaves out of the project's own notebooks what is not theirs, before Jupyter saves one:
    outputs, and what a machine adds of itself. What git shows as changed is what somebody has
    changed. Copies under other names keep everything.
    """
    notebook, file = model["content"], contents_manager._get_os_path(path)
    if model["type"] != "notebook" or not _own(file):
        return
    notebook["metadata"] = METADATA
    for cell in notebook["cells"]:
        tags = cell["metadata"].get("tags")
        cell["metadata"] = {"tags": tags} if tags else {}
        if cell["cell_type"] == "code":
            cell["outputs"], cell["execution_count"] = [], None


def _own(file: str) -> bool:
    own = project_root() / "notebooks"
    names = ("explore.ipynb", "experiment.ipynb", "[0-9][0-9]_*.ipynb")
    return any(str(path) == file for name in names for path in own.glob(name))
