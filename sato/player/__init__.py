"""Player of a run: one HTML file that opens without a network."""

from sato.player.page import DEFAULT_NAME, write_player

__all__ = ["DEFAULT_NAME", "write_player"]
