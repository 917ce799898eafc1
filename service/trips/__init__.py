"""Trips after they were driven: how risky, what was done, what they add to scores."""
