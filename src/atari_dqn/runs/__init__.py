"""A run's folder: training into it, resuming, evaluating, verifying. Knows nothing of reports."""
