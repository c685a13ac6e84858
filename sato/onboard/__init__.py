"""Onboard code: C that solves one agent's transfer, generated from a scenario."""

from sato.onboard.export import export_c

__all__ = ["export_c"]
