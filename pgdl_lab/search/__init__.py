"""Searches with Optuna: what a trial varies, how trials are shared out and judged, what a study leaves behind."""
