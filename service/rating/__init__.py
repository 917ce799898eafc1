"""What a tenant rates by: risk tables, score model and tariff, as shipped or its own."""
