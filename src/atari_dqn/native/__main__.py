"""`python -m atari_dqn.native` compiles the native learner, or says why PyTorch will learn."""

from atari_dqn.native import Unavailable, load, torch_instead

try:
    load()
except Unavailable as error:
    print(torch_instead(error))
else:
    print("The native learner is ready.")
