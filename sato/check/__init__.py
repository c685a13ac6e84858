"""Checking of a run: promises that are recomputed, and the report of them."""

from sato.check.report import Promise, Report

__all__ = ["Promise", "Report"]
