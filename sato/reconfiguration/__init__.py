"""System 1, swarm reconfiguration: auction, then sequential convex programming [Morgan2016]."""
