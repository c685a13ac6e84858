"""Code for on board: C that solves one agent's programme, written from a scenario."""

from sato.onboard.export import export_c

__all__ = ["export_c"]
