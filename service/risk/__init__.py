"""Risk: what the core assesses, read from files and told."""
