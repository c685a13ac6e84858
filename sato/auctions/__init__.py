"""Auctions: bids, VSDAA and CBAA."""
