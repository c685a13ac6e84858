"""Campaigns: many runs of scenarios, in one table, that can be interrupted and resumed."""
