"""Checking of a run: promises that are recomputed, and the report of them."""

from sato.check.promise import Promise
from sato.check.report import Report

__all__ = ["Promise", "Report"]
