"""What kernels, and the processes that execute notebooks, take long to load.

For the process that they are forked from and for none else, since this sets what libraries read
while they are loaded.
"""

import importlib
import os

os.environ["OMP_NUM_THREADS"] = "1"
os.environ["MPLBACKEND"] = "module://matplotlib_inline.backend_inline"  # as a kernel sets it

for name in (
    *("ipykernel.kernelapp", "ipykernel.zmqshell", "tabulate"),
    # Not `outputs`, which is prepared by the shell that it finds when it is loaded
    *("atari_dqn.report.execution", "atari_dqn.report.plots", "atari_dqn.report.video"),
):
    importlib.import_module(name)
