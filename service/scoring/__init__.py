"""Scores: the model and tariff that ship with the core, or a user's own, read from files."""
