"""Scores that an insurer prices with and a driver understands: how much (PAYD), how (PHYD) and where (PWYD)."""
