"""Deep Q-Networks on Atari Boxing and Breakout: a reproducible study.

Four floors, each of which imports only from itself and from those below: the report (`report`), the
numbers behind it (`analysis`), the folders of runs (`runs`), and the agents, which are the modules
of this folder.
"""
