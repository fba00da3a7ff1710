"""Deep Q-Networks on Atari Boxing and Breakout: a reproducible study.

Modules import only downwards, in this order:

params -> envs, networks, replay -> agents, exploration -> training -> checkpoints
-> evaluation -> runs -> recording -> experiments -> statistics, plots, sections, report -> __main__
"""
