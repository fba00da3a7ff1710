"""Deep Q-Networks on Atari Boxing and Breakout: a reproducible study.

Modules import only downwards, from `__main__` to `params`; `diagrams.project_files` draws them.
"""
