"""What kernels, and the processes that execute notebooks, take long to load.

For the process that they are forked from and for none else, since this sets what libraries read
while they are loaded.
"""

# ruff: noqa: F401

import os

os.environ["OMP_NUM_THREADS"] = "1"
os.environ["MPLBACKEND"] = "module://matplotlib_inline.backend_inline"  # as a kernel sets it

import ipykernel.kernelapp
import ipykernel.zmqshell
import tabulate

# Not `outputs`, which is prepared by the shell that it finds when it is loaded
from atari_dqn.report import execution, plots, video
