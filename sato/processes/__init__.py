"""Vehicles of a reconfiguration as processes of the operating system, and the world they fly in."""
