"""Judging a run from its file alone: what it promises is recomputed, and what is said of it.

`judge` is for every run. A system judges what is its own by means of `promise`, `common` and
`happened`.
"""

from sato.check.promise import Promise
from sato.check.report import Report

__all__ = ["Promise", "Report"]
