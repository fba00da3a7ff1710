"""One notebook of the report, executed by papermill.

It imports little else, since a process of the report's pool loads only this.
"""

import os
from pathlib import Path

import papermill

from atari_dqn.report import kernels
from atari_dqn.runs.files import RunError

STARTS = 3  # of a notebook's kernel, whose ports another's may take before it does


def execute(notebook: Path, target: Path, profile: str, results: Path) -> None:
    """Executes one notebook; raises RunError that names the section, the cell and the error."""
    os.environ["OMP_NUM_THREADS"] = "1"  # of the notebook's process: another has the other core
    partial = target / f".{notebook.name}"
    for old in (f"{notebook.stem}.inputs", notebook.name):  # the stamp first, if one is left
        (target / old).unlink(missing_ok=True)
    for start in range(STARTS):
        try:
            papermill.execute_notebook(
                notebook,
                partial,
                {"profile": profile, "results_dir": str(results.resolve())},
                cwd=str(notebook.parent),
                kernel_name="python3",
                progress_bar=False,
                request_save_on_cell_execute=False,
                extra_arguments=["--log-level=ERROR"],
                kernel_manager_class=kernels.Kernels,
            )
        except papermill.PapermillExecutionError as error:
            partial.unlink(missing_ok=True)
            where = f"section {notebook.name}, cell {error.cell_index}"
            raise RunError(f"{where}: {error.ename}: {error.evalue}") from None
        except RuntimeError as error:
            partial.unlink(missing_ok=True)
            if "before replying" not in str(error) or start == STARTS - 1:
                raise RunError(f"section {notebook.name}: {error}") from None
        else:
            break
    partial.replace(target / notebook.name)
