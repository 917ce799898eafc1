"""The schema's history, in Alembic's form; ``service.storage.schema`` runs it."""
