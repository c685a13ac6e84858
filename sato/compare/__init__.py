"""Comparison of solvers on equal problems: verified answers and median times."""
